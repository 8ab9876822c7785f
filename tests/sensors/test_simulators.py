"""States of simulators become transforms of instances as the guide says; each simulator is the judge where it is installed."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
import warp as wp

import wrt

MODEL = """
<mujoco>
  <worldbody>
    <geom name="floor" type="box" size="20 20 0.5" pos="0 0 -0.5"/>
    <body name="crate" pos="0 0 2"><freejoint/><geom name="crate" type="box" size="0.5 0.4 0.3"/></body>
    <body name="arm" pos="2 0 1" euler="0 30 0">
      <joint name="hinge" type="hinge" axis="0 1 0"/>
      <geom name="upper" type="box" size="0.2 0.2 0.6" pos="0 0 0.6"/>
      <body name="hand" pos="0 0 1.2"><joint type="hinge" axis="1 0 0"/><geom name="hand" type="box" size="0.1 0.5 0.1"/></body>
    </body>
  </worldbody>
</mujoco>
"""


def matrices(positions: np.ndarray, rotations: np.ndarray) -> np.ndarray:
    """(N, 4, 4) from (N, 3) and (N, 3, 3), as in the guide."""
    found = np.tile(np.eye(4), (len(positions), 1, 1))
    found[:, :3, :3], found[:, :3, 3] = rotations, positions
    return found


def test_mujoco():
    """While bodies fall and swing: the ranges of MuJoCo's own rays."""
    mujoco = pytest.importorskip("mujoco", reason="MuJoCo is not installed: pip install mujoco")
    model = mujoco.MjModel.from_xml_string(MODEL)
    data = mujoco.MjData(model)
    meshes = [trimesh.creation.box(2.0 * size) for size in model.geom_size]
    scene = wrt.Scene([wrt.Instance(wrt.TriangleMesh(mesh.vertices, mesh.faces)) for mesh in meshes], device="cpu")
    rng, index = np.random.default_rng(0), np.arange(model.ngeom)
    for _ in range(4):
        mujoco.mj_step(model, data, nstep=60)
        mujoco.mj_forward(model, data)
        scene.update(index, transform=matrices(data.geom_xpos, data.geom_xmat.reshape(-1, 3, 3)))
        origins = rng.uniform([-3, -3, 0.1], [4, 3, 4], (300, 3))
        directions = rng.normal(size=(300, 3))
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        hits, geom, judged = scene.intersect(origins, directions), np.zeros(1, dtype=np.int32), 0
        for ray, (origin, direction) in enumerate(zip(origins, directions, strict=True)):
            distance = mujoco.mj_ray(model, data, origin, direction, None, 1, -1, geom)
            inside = scene.count(origin, direction) % 2  # MuJoCo sees boxes from outside only
            if not inside:
                judged += 1
                assert hits.t[ray] == pytest.approx(np.inf if distance < 0 else distance, abs=1e-4)
        assert judged > 150
    assert len(set(np.unique(hits.instance_id)) - {-1}) >= 3


def test_newton():
    """`State.body_q` is a Warp array of transforms, which `Scene.update` takes as it is."""
    newton = pytest.importorskip("newton", reason="Newton is not installed: pip install newton")
    builder = newton.ModelBuilder()
    placed = [wp.transform((x, 0.5, 2.0), wp.quat_from_axis_angle(wp.vec3(0.0, 0.6, 0.8), 0.3 * x)) for x in (0.0, 3.0)]
    for place in placed:
        body = builder.add_body(xform=place)
        builder.add_shape_box(body, hx=0.5, hy=0.4, hz=0.3)
    state = builder.finalize(device="cpu").state()
    assert isinstance(state.body_q, wp.array)
    mesh = trimesh.creation.box((1.0, 0.8, 0.6))
    box = wrt.TriangleMesh(mesh.vertices, mesh.faces)
    scene = wrt.Scene([wrt.Instance(box), wrt.Instance(box)], device="cpu")
    scene.update([0, 1], transform=state.body_q)
    for instance, place in zip(scene.instances, placed, strict=True):
        point = wp.transform_point(place, wp.vec3(0.5, -0.4, 0.3))
        np.testing.assert_allclose(instance.transform @ [0.5, -0.4, 0.3, 1.0], [*point, 1.0], atol=1e-6)


def test_poses_of_isaac_lab():
    """Isaac Lab 3 has Warp arrays of poses with quaternions x, y, z, w, in environments by bodies; they are flattened."""
    rng = np.random.default_rng(1)
    turns = rng.normal(size=(6, 4))
    turns /= np.linalg.norm(turns, axis=1, keepdims=True)
    poses = np.concatenate([rng.normal(size=(6, 3)), turns], axis=1).astype(np.float32)
    pose = wp.array(poses.reshape(3, 2, 7), dtype=wp.transformf, device="cpu")
    mesh = wrt.TriangleMesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    scene = wrt.Scene([wrt.Instance(mesh, environment=k // 2) for k in range(6)], device="cpu")
    scene.update(np.arange(6), transform=pose.flatten())
    for instance, row in zip(scene.instances, poses.astype(np.float64), strict=True):
        expected = trimesh.transformations.quaternion_matrix(row[[6, 3, 4, 5]])
        expected[:3, 3] = row[:3]
        np.testing.assert_allclose(instance.transform, expected, atol=1e-6)
