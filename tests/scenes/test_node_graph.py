"""Scenes made of a trimesh.Scene: nodes are moved by name, and what hangs on them moves along."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
import trimesh
from support.hits import assert_same_hits

import wrt


def turn(angle: float, axis: tuple[float, float, float], shift: tuple[float, float, float]) -> np.ndarray:
    matrix = trimesh.transformations.rotation_matrix(angle, axis)
    matrix[:3, 3] = shift
    return matrix


def robot() -> trimesh.Scene:
    """A base, an arm on it, a hand without triangles on that, two fingers on the hand; and a ball that stands alone."""
    graph = trimesh.Scene()
    graph.add_geometry(trimesh.creation.box((2, 2, 1)), node_name="base", geom_name="block")
    arm = trimesh.creation.box((0.5, 0.5, 2))
    graph.add_geometry(
        arm, node_name="arm", geom_name="rod", parent_node_name="base", transform=turn(0.2, (0, 1, 0), (0, 0, 1.5))
    )
    graph.graph.update(frame_from="arm", frame_to="hand", matrix=turn(0.0, (0, 0, 1), (0, 0, 1.2)))
    for name, side in (("left", -0.4), ("right", 0.4)):
        place = turn(0.0, (0, 0, 1), (side, 0, 0.3)) @ np.diag([0.3, 0.3, 0.3, 1.0])
        graph.add_geometry(arm, node_name=name, geom_name="rod", parent_node_name="hand", transform=place)
    ball = trimesh.creation.icosphere(2)
    graph.add_geometry(ball, node_name="ball", geom_name="ball", transform=turn(0.0, (0, 0, 1), (3, 0, 0)))
    return graph


@pytest.fixture(scope="module")
def rays():
    rng = np.random.default_rng(0)
    return rng.uniform(-4, 6, (3000, 3)), rng.normal(size=(3000, 3))


MOVES = {"arm": turn(-0.7, (0, 1, 0), (0.1, 0, 1.5)), "hand": turn(1.1, (0, 0, 1), (0, 0.2, 1.3))}


def moved_robot() -> trimesh.Scene:
    graph = robot()
    parents = graph.graph.transforms.parents
    for name, matrix in MOVES.items():
        graph.graph.update(frame_from=parents[name], frame_to=name, matrix=matrix)
    return graph


def test_nodes_move_by_name(rays):
    """As a scene made of the moved graph, by trimesh's own arithmetic; only what hangs below is updated."""
    scene, there = wrt.Scene(robot(), device="cpu"), moved_robot()
    before = scene.instances
    scene.move(MOVES)
    assert_same_hits(scene.intersect(*rays), wrt.Scene(there, device="cpu").intersect(*rays))
    for name in scene.node_names:
        np.testing.assert_allclose(scene.node_transform(name), there.graph[name][0], atol=1e-12)
    np.testing.assert_array_equal(scene.node_transform("hand", to_parent=True), MOVES["hand"])
    still = {name: int(scene.node_instances(name)[0]) for name in ("base", "ball")}
    assert all(scene.instances[number] is before[number] for number in still.values())
    assert len(scene.node_instances("hand")) == 0
    hits = scene.intersect([3.0, 0, 9], [0.0, 0, -1])
    assert hits.instance_id == still["ball"]


def test_names_come_after_their_parents():
    names = wrt.Scene(robot(), device="cpu").node_names
    assert set(names) == {"base", "arm", "hand", "left", "right", "ball"}
    assert names.index("base") < names.index("arm") < names.index("hand") < min(names.index("left"), names.index("right"))


def test_other_members_and_copies_keep_the_graph(rays, tmp_path):
    """Beside other instances; after members came and went; after an update, from a file and from a pickle."""
    street = wrt.TriangleMesh([[-9, -9, -1], [9, -9, -1], [0, 9, -1]], [[0, 1, 2]])
    scene = wrt.Scene([wrt.Instance(street), robot()], device="cpu")
    extra = scene.add(wrt.Instance(street, turn(0.0, (0, 0, 1), (0, 0, 9))))
    scene.remove([0, int(scene.node_instances("ball")[0])])
    scene.update(len(scene.instances) - 1, transform=turn(0.0, (0, 0, 1), (0, 0, 8)))
    scene.save(tmp_path / "robot.npz")
    others = [scene, pickle.loads(pickle.dumps(scene)), wrt.Scene.load(tmp_path / "robot.npz", device="cpu")]
    assert extra.tolist() == [6]
    expected = moved_robot()
    expected.delete_geometry("ball")
    standing = wrt.Instance(street, turn(0.0, (0, 0, 1), (0, 0, 8)))
    answer = wrt.Scene([expected, standing], device="cpu").intersect(*rays)
    for one in others:
        one.move(MOVES)
        assert_same_hits(one.intersect(*rays), answer)
        assert len(one.node_instances("ball")) == 0
        one.move({"ball": np.eye(4)})  # nothing hangs on it


def test_two_graphs_with_the_same_names(rays):
    """Names of one only are found; the others are ambiguous."""
    scene = wrt.Scene([robot(), robot()], device="cpu")
    assert len(scene.node_names) == 12
    with pytest.raises(ValueError, match="'arm' is the name of 2 nodes"):
        scene.move({"arm": np.eye(4)})


@pytest.mark.parametrize(
    ("nodes", "error", "message"),
    [
        ({"elbow": np.eye(4)}, ValueError, "'elbow' is not in the scene's graph; the nodes are"),
        ({3: np.eye(4)}, TypeError, "names of nodes are str"),
        ({}, TypeError, "at least one"),
        ([("arm", np.eye(4))], TypeError, "dict"),
        ({"hand": np.eye(3)}, ValueError, r"nodes\['hand'\]"),
        ({"arm": np.eye(4), "hand": np.zeros((4, 4))}, ValueError, r"nodes\['hand'\]"),
    ],
)
def test_wrong_arguments_change_nothing(nodes, error, message):
    scene = wrt.Scene(robot(), device="cpu")
    state = scene.state
    with pytest.raises(error, match=message):
        scene.move(nodes)
    assert scene.state is state


def test_scenes_without_a_graph():
    box = wrt.TriangleMesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    for scene, message in (
        (wrt.Scene(box, device="cpu"), "instances"),
        (wrt.Scene([wrt.Instance(box)], device="cpu"), "graph"),
    ):
        assert scene.node_names == ()
        with pytest.raises(ValueError, match=message):
            scene.move({"arm": np.eye(4)})
        with pytest.raises(ValueError, match="no graph"):
            scene.node_transform("arm")


@pytest.mark.parametrize("below", [False, True])
def test_a_mesh_on_the_base_frame(below):
    """It hangs on no node that could move. It was once a KeyError."""
    graph = trimesh.Scene()
    if below:
        graph.add_geometry(trimesh.creation.icosphere(1), node_name="ball", transform=turn(0.3, (0, 1, 0), (5, 0, 0)))
    graph.geometry["block"] = trimesh.creation.box((1, 1, 1))
    graph.graph.transforms.node_data[graph.graph.base_frame]["geometry"] = "block"
    scene = wrt.Scene(graph, device="cpu")
    assert scene.intersect([0.0, 0.0, 9.0], [0.0, 0.0, -1.0]).t == 8.5
    assert [mesh.triangle_count for mesh in wrt.moving.nested_meshes(graph)] == ([12, 80] if below else [12])
    if below:
        scene.move({"ball": np.eye(4)})
        assert scene.intersect([0.0, 0.0, 9.0], [0.0, 0.0, -1.0]).t < 8.5


def test_a_base_frame_below_itself():
    """As trimesh 4.0 reads it from glTF files."""
    scene = trimesh.Scene([trimesh.creation.box()])
    base = scene.graph.base_frame
    scene.graph.transforms.add_edge(base, base, matrix=np.eye(4))
    assert wrt.Scene(scene, device="cpu").intersect([0.1, 0.2, 5.0], [0.0, 0.0, -1.0]).t == 4.5


@pytest.mark.parametrize("make", [lambda scene: wrt.Scene(scene, device="cpu"), wrt.TriangleMesh.from_trimesh])
def test_a_node_below_itself(make):
    scene = trimesh.Scene([trimesh.creation.box()])
    (node,) = scene.graph.nodes_geometry
    scene.graph.transforms.add_edge("above", node, matrix=np.eye(4))
    scene.graph.transforms.add_edge(node, "above", matrix=np.eye(4))
    with pytest.raises(ValueError, match=f"the node '{node}' of the trimesh.Scene is below itself"):
        make(scene)
