"""A robot's URDF, read by yourdfpy, is a scene whose joints move it."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

import wrt

yourdfpy = pytest.importorskip("yourdfpy", reason="yourdfpy is not installed: pip install yourdfpy")

URDF = """<robot name="arm">
  <link name="base"><visual><geometry><box size="1 1 1"/></geometry></visual></link>
  <link name="upper"><visual><origin xyz="0 0 1"/><geometry><box size="0.3 0.3 2"/></geometry></visual></link>
  <link name="hand"><visual><geometry><sphere radius="0.3"/></geometry></visual></link>
  <joint name="shoulder" type="revolute">
    <parent link="base"/><child link="upper"/><origin xyz="0 0 0.5"/><axis xyz="0 1 0"/>
    <limit lower="-2" upper="2" effort="1" velocity="1"/>
  </joint>
  <joint name="lift" type="prismatic">
    <parent link="upper"/><child link="hand"/><origin xyz="0 0 2"/><axis xyz="0 0 1"/>
    <limit lower="0" upper="1" effort="1" velocity="1"/>
  </joint>
</robot>"""


@pytest.fixture
def robot(tmp_path):
    path = tmp_path / "arm.urdf"
    path.write_text(URDF)
    return yourdfpy.URDF.load(str(path))


def test_joints_move_the_scene(robot):
    """Links are where a new scene of the pose has them, and rays meet them there."""
    cell = wrt.Scene([robot.scene], device="cpu")
    assert len(cell.instances) == 3
    for angle, height in ((0.4, 0.3), (-1.1, 0.9)):
        robot.update_cfg({"shoulder": angle, "lift": height})
        cell.move({joint.child: robot.get_transform(joint.child, joint.parent) for joint in robot.actuated_joints})
        for link in ("upper", "hand"):
            np.testing.assert_allclose(cell.node_transform(link), robot.get_transform(link), atol=1e-12)
        reach = 2.0 + height
        hand = np.array([reach * np.sin(angle), 0.0, 0.5 + reach * np.cos(angle)])
        hits = cell.intersect(hand - np.array([0.0, 5.0, 0.0]), (0.0, 1.0, 0.0))
        assert hits.instance_id == cell.node_instances(cell.node_names[-1])[0]
        assert hits.t == pytest.approx(4.7, abs=0.02)


def test_a_sensor_leaves_its_robot_out(robot):
    """By the mask of its instances: the walls behind it are seen through it."""
    room = trimesh.creation.box((12, 12, 12))
    cell = wrt.Scene([wrt.Instance(room, mask=2), robot.scene], device="cpu")
    body = np.concatenate([cell.node_instances(name) for name in cell.node_names])
    cell.update(body, mask=1)
    pose = cell.node_transform("upper") @ trimesh.transformations.translation_matrix([0, 1.5, 1.0])
    lidar = wrt.sensors.Lidar.preset("ouster_os1_64", columns=72)
    assert np.isin(lidar.scan(cell, pose).instance_id, body).any()
    through = lidar.scan(cell, pose, mask=2)
    assert (through.instance_id == 0).all()
