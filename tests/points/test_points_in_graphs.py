"""Closest points captured in graphs: at each launch those of a call, of the points and instances of that moment."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp
from support.point_oracles import answers, points_around
from support.random_instances import BALL, BOX

import wrt

COUNT = 60


def bodies(seed: int) -> np.ndarray:
    """(COUNT, 7) float32: positions and quaternions of any length."""
    rng = np.random.default_rng(seed)
    return np.concatenate([rng.uniform(-5, 5, (COUNT, 3)), rng.normal(size=(COUNT, 4))], axis=1).astype(np.float32)


def crowd(device: str) -> wrt.Scene:
    return wrt.Scene([wrt.Instance(BALL if k % 3 else BOX, mask=1 << k % 2) for k in range(COUNT)], "bvh", device=device)


def on(device: str, values: np.ndarray, dtype: type) -> wp.array:
    return wp.array(values, dtype=dtype, device=device)


def test_graphs_measure_what_is_there(device):
    """One mesh, and instances that a graph moves where the device can; points that are sorted, and the nearest two."""
    scenes, mesh = [crowd(device), crowd(device)], wrt.Scene(BALL, device=device)
    flat = wrt.TriangleMesh.concatenate([BALL, BOX])
    points = on(device, points_around(flat, 1500), wp.vec3)
    moving, masks = on(device, bodies(0), wp.transformf), on(device, np.arange(1500) % 3 + 1, wp.uint32)

    def step(scene: wrt.Scene) -> list[dict]:
        if not scene.device.is_capturing or scene.device.is_cuda:
            scene.update(range(COUNT), transform=moving)
        own = scene.closest_point(points, max_distance=4.0), scene.closest_point(points, k=2, mask=masks)
        return [answers(found) for found in (*own, mesh.closest_point(points, max_distance=2))]

    for _ in range(2):  # the first may build the upper tree again, on the host
        step(scenes[0])
    with wp.ScopedCapture(device) as capture:
        found = step(scenes[0])
    for seed in range(3):
        points.assign(on(device, points_around(flat, 1500)[::-1] + np.float32(seed), wp.vec3))
        if scenes[0].device.is_cuda:
            moving.assign(on(device, bodies(seed), wp.transformf))
        wp.capture_launch(capture.graph)
        for one, other in zip(found, step(scenes[1]), strict=True):
            for name, values in other.items():
                np.testing.assert_array_equal(one[name].numpy(), values.numpy(), err_msg=name)


def test_maps_of_moves_on_the_device(device):
    """Of `wp.transform` they are known to be fine. Matrices are looked at, and cannot be in a graph."""
    scene, points = crowd(device), on(device, np.zeros((3, 3)), wp.vec3)
    matrices = np.tile(np.eye(4, dtype=np.float32), (COUNT, 1, 1))
    scene.update(range(COUNT), transform=on(device, bodies(0), wp.transformf))
    scene.update(np.arange(COUNT - 3), transform=on(device, bodies(1)[:-3], wp.transformf))
    assert scene.state.device_moves is None or scene.state.device_moves.are_similar
    scene.update(range(COUNT), transform=on(device, matrices, wp.float32))
    scene.closest_point(points)
    if scene.state.device_moves is not None:
        assert not scene.state.device_moves.are_similar
        with wp.ScopedCapture(device), pytest.raises(RuntimeError, match=r"not wp.transform.*before or after the capture"):
            scene.closest_point(points)
    matrices[5, 0, 0] = 3.0
    scene.update(range(COUNT), transform=on(device, matrices, wp.float32))
    with pytest.raises(ValueError, match="instance 5 is not"):
        scene.closest_point(points)


REFUSED = {
    "not in a Warp array": lambda scene, points: scene.closest_point(np.zeros((4, 3))),
    "max_distance must be": lambda scene, points: scene.closest_point(points, max_distance=np.ones(4)),
    "closest_point cannot": lambda scene, points: scene.closest_point(points, precise=True),
    "within cannot": lambda scene, points: scene.within(points, 0.5),
}


@pytest.mark.parametrize("what", REFUSED)
def test_what_needs_the_host_is_refused(what, device):
    scene, points = wrt.Scene(BALL, device=device), on(device, np.zeros((4, 3)), wp.vec3)
    scene.closest_point(points)
    with wp.ScopedCapture(device), pytest.raises(RuntimeError, match=f"{what}.*before or after the capture"):
        REFUSED[what](scene, points)
