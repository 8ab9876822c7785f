"""Scenes of instances: the answers of every instance asked alone, masks, back faces, bad input."""

from __future__ import annotations

import pickle
import threading

import numpy as np
import pytest
import trimesh
import warp as wp
from support.hits import assert_same_hits, mixed_rays
from support.ptx import compile_to_ptx
from support.random_instances import BALL, BOX, FLAT, asked_alone, move, random_instances

import wrt
from wrt.kernels.runtime.launch import CUDA_BLOCK, use_threads
from wrt.kernels.traversal import TRAVERSALS as TABLE
from wrt.kernels.traversal.traversal_config import StackConfig, TraversalConfig
from wrt.kernels.traversal.two_level.instance_single import make_instance_kernel

TRAVERSALS = {
    tree: [name for name, way in TABLE.items() if tree in way.on and way.on[tree].instances and way.width is None]
    for tree in ("bvh", "kdtree")
}
"""Those for trees of any width; of width 2: tests/traversals/test_persistent.py."""


@pytest.fixture(scope="module", params=["bvh", "kdtree"])
def scene(request: pytest.FixtureRequest) -> wrt.Scene:
    return wrt.Scene(random_instances(), request.param, device="cpu")


@pytest.fixture(scope="module")
def rays(scene) -> tuple[np.ndarray, np.ndarray]:
    """Rays of every kind, at vertices and edges too."""
    return mixed_rays(scene.flattened(), 6000)


def test_as_every_instance_asked_alone(scene, rays):
    """To the bit, whatever the traversal; ties go to the earlier instance."""
    t, triangle, uv, counts = (np.stack(values) for values in zip(*asked_alone(scene, *rays), strict=True))
    first, ray = t.argmin(axis=0), np.arange(len(rays[0]))
    assert np.isfinite(t.min(axis=0)).mean() > 0.3
    for traversal in TRAVERSALS[scene.accelerator.kind]:
        hits = scene.intersect(*rays, traversal=traversal)
        np.testing.assert_array_equal(hits.t, t.min(axis=0))
        np.testing.assert_array_equal(hits.primitive_id, triangle[first, ray])
        np.testing.assert_array_equal(hits.uv, uv[first, ray])
        np.testing.assert_array_equal(hits.instance_id, np.where(hits.is_hit, first, -1))
        np.testing.assert_array_equal(hits.geometry_id, np.where(hits.is_hit, np.array(scene.geometry_ids)[first], -1))
        if traversal != "packet":
            np.testing.assert_array_equal(scene.count(*rays, traversal=traversal), counts.sum(axis=0))
        if traversal == "stream":
            np.testing.assert_array_equal(scene.occluded(*rays, traversal=traversal), hits.is_hit)
    assert not (hits.instance_id == 1).any()  # which is the same as instance 0


def test_all_hits(scene, rays):
    lists, hits = scene.intersect_all(*rays), scene.intersect(*rays)
    np.testing.assert_array_equal(lists.count, scene.count(*rays))
    np.testing.assert_array_equal(np.bincount(lists.ray_id, minlength=len(rays[0])), lists.count)
    same_ray = lists.ray_id[1:] == lists.ray_id[:-1]
    number = lists.instance_id * 1000 + lists.primitive_id
    later = (np.diff(lists.t) > 0) | ((np.diff(lists.t) == 0) & (np.diff(number) > 0))
    assert later[same_ray].all()
    begins = lists.offsets[:-1][lists.count > 0]
    assert (lists.t[begins] == hits.t[lists.count > 0]).mean() > 0.98  # at edges they may name another triangle
    nearest = scene.intersect_all(*rays, max_hits=1)
    np.testing.assert_array_equal(nearest.t, lists.t[begins])
    np.testing.assert_allclose(
        lists.position, rays[0][lists.ray_id] + lists.t[:, None] * rays[1][lists.ray_id], rtol=0, atol=1e-4 * 20
    )


def test_against_the_flattened_mesh(scene):
    """Points, normals and what follows from them are those in the scene; mirrored instances keep their outer side."""
    rng = np.random.default_rng(3)
    origins, directions = rng.uniform(*scene.bounds, (4000, 3)), rng.normal(size=(4000, 3))
    flat = wrt.Scene(scene.flattened(), scene.accelerator, device="cpu")
    hits, expected = scene.intersect(origins, directions), flat.intersect(origins, directions, traversal="single")
    first = np.cumsum([0, *(scene.meshes[number].triangle_count for number in scene.geometry_ids)])
    same = hits.is_hit & (first[hits.instance_id] + hits.primitive_id == expected.primitive_id)
    assert same.sum() > max(0.995 * hits.is_hit.sum(), 500)
    assert (hits.is_hit != expected.is_hit).mean() < 0.001
    np.testing.assert_allclose(hits.normal[same], expected.normal[same], rtol=0, atol=1e-4)
    np.testing.assert_allclose(hits.position[same], expected.position[same], rtol=0, atol=1e-3)
    mirrored = np.array([np.linalg.det(instance.transform) < 0 for instance in scene.instances])
    assert mirrored.any()
    swapped = mirrored[hits.instance_id[same]]
    assert np.abs(np.where(swapped[:, None], hits.uv[same][:, ::-1], hits.uv[same]) - expected.uv[same]).max() < 1e-2
    points = np.random.default_rng(1).uniform(*scene.bounds, (2000, 3)).astype(np.float32)
    np.testing.assert_array_equal(scene.contains(points, traversal="single"), flat.contains(points, traversal="single"))
    few = points[:15]
    np.testing.assert_array_equal(scene.visible(few[:, None], few), flat.visible(few[:, None], few))
    outwards = hits.spawn(hits.normal)[hits.is_hit]
    again = scene.intersect(outwards, hits.normal[hits.is_hit])
    other = (again.instance_id != hits.instance_id[hits.is_hit]) | (again.primitive_id != hits.primitive_id[hits.is_hit])
    assert other.all()


def test_verify(scene):
    report = scene.verify(200)
    assert report.ok, str(report)
    assert sum(report.hits.values()) > 100


def test_pictures():
    """Shading takes smooth normals through the maps: the same picture as that of the flattened mesh."""
    matrix = trimesh.transformations.rotation_matrix(0.4, [1, 2, 3]) @ np.diag([1.5, -0.7, 1.0, 1.0])
    scene = wrt.Scene(
        [wrt.Instance(BALL, matrix), wrt.Instance(BALL, move(2.5)), wrt.Instance(BOX, move(0, 2.2))], device="cpu"
    )
    camera = wrt.PinholeCamera.framing(scene.flattened(), 48, 32)
    options = {"ambient_samples": 2, "traversal": "single"}
    picture = wrt.render(scene, camera, **options)
    difference = np.abs(picture - wrt.render(wrt.Scene(scene.flattened(), device="cpu"), camera, **options))
    assert picture.std() > 0.05
    assert (difference.max(axis=2) > 0.02).mean() < 0.1
    assert np.median(difference) < 1e-3
    scene.update(1, transform=move(-2.5))
    assert np.abs(wrt.render(scene, camera, **options) - picture).max() > 0.1


@pytest.mark.parametrize("far", [0.0, 1e7])
def test_far_from_the_origin(far):
    """A small thing in a wide scene, and all of it far away: hits are as exact as near the origin."""
    small = np.diag([1e-3, 1e-3, 1e-3, 1.0])
    matrices = [move(far + 500.0, far, far) @ small, move(far, far, far) @ small]
    scene = wrt.Scene([wrt.Instance(BALL, matrix) for matrix in matrices], device="cpu")
    directions = np.random.default_rng(0).normal(size=(500, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    for k, start in enumerate(([500.0, 0.0, 0.0], [0.0, 0.0, 0.0])):
        hits = scene.intersect(np.array(start) + far, directions)
        assert (hits.instance_id == k).all()
        radius = np.linalg.norm(hits.t[:, None] * directions, axis=1)
        assert (radius <= 1.001e-3).all()
        assert (radius >= 0.94e-3).all()
    assert scene.contains(np.array([[far + 500, far, far], [far + 250, far, far]])).tolist() == [True, False]


def test_too_far_apart():
    """Where float64 has no digits left for an instance, rays once missed it in silence."""
    near = wrt.Instance(BALL)
    for far in (1e13, 1e30):
        with pytest.raises(ValueError, match=r"instance 0 is 2 large and .* another scene, .* mask=0"):
            wrt.Scene([near, wrt.Instance(BALL, move(far))], device="cpu")
    large = np.diag([1e30, 1e30, 1e30, 1.0])
    scene = wrt.Scene([wrt.Instance(BALL, large), wrt.Instance(BALL, move(3e30) @ large)], device="cpu")
    hits = scene.intersect([0.0, 0.0, 0.0], [[1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
    assert (hits.t > 0.9e30).all()
    assert (hits.instance_id == 0).all()
    with pytest.raises(ValueError, match="instance 1 is"):
        scene.update(1, transform=move(3e30))
    scene.update(1, transform=move(3e30), mask=0)
    assert (scene.intersect([0.0, 0.0, 0.0], [0.0, 1.0, 0.0], mask=1).instance_id == 0).all()


@pytest.mark.parametrize("traversal", ["single", "stream", "packet"])
def test_more_boxes_than_a_list_holds(traversal):
    """Sixty shells, one around the other: rays from outside meet the boxes of all of them, and leave through the same."""
    shells = [wrt.Instance(BALL, np.diag([r, r, r, 1.0])) for r in np.linspace(3, 1, 60)]
    scene = wrt.Scene(shells, device="cpu")
    rng = np.random.default_rng(0)
    outside = rng.normal(size=(1500, 3))
    outside *= 4.0 / np.linalg.norm(outside, axis=1, keepdims=True)
    inside = 0.1 * rng.normal(size=(1500, 3)).clip(-2, 2)
    with use_threads(3):
        assert (scene.intersect(outside, -outside, traversal=traversal).instance_id == 0).all()
        assert (scene.intersect(inside, outside, traversal=traversal).instance_id == 59).all()
        lone = scene.intersect(inside, outside, mask=1 << 31, traversal=traversal)
        assert_same_hits(lone, scene.intersect(inside, outside, traversal="single"))
        if traversal != "packet":
            assert (scene.count(outside, -outside, traversal=traversal) == 120).all()
            assert (scene.count(inside, outside, traversal=traversal) == 60).all()


@pytest.mark.parametrize("traversal", ["stream", "packet"])
def test_blocks_of_a_picture(traversal, monkeypatch):
    """Blocks that end within rows of tiles, rounds of a few rays: nothing shows."""
    monkeypatch.setattr("wrt.engine.launch.instance_rounds.BLOCK", 512)
    monkeypatch.setattr("wrt.engine.launch.instance_rounds.MIN_ROUND_SHARE", 1 / 1000)
    scene = wrt.Scene(random_instances(), device="cpu")
    rays = wrt.PinholeCamera.framing(scene.flattened(), 61, 43).rays()
    hits = scene.intersect(rays, traversal=traversal)
    assert hits.plan.reorder == ("tiles" if traversal == "packet" else "none")
    assert 0.1 < hits.is_hit.mean() < 0.9
    assert_same_hits(hits, scene.intersect(rays, traversal="single"))


def test_masks(scene, rays):
    """A ray sees what a scene of the instances that it sees would show it."""
    for mask in (0, 0b0001, 0b0110):
        kept = [k for k, instance in enumerate(scene.instances) if instance.mask & mask]
        for traversal in TRAVERSALS[scene.accelerator.kind]:
            hits = scene.intersect(*rays, mask=mask, traversal=traversal)
            assert set(hits.instance_id) <= {-1, *kept}
        visible = wrt.Scene([scene.instances[k] for k in kept], scene.accelerator, device="cpu") if kept else None
        expected = visible.intersect(*rays).is_hit if kept else np.zeros(len(rays[0]), dtype=bool)
        assert (hits.is_hit != expected).mean() < 0.001
        np.testing.assert_array_equal(scene.occluded(*rays, mask=mask), hits.is_hit)
    masks = np.random.default_rng(0).integers(0, 16, len(rays[0]))
    mixed, each = scene.intersect(*rays, mask=masks), [scene.intersect(*rays, mask=mask) for mask in range(16)]
    np.testing.assert_array_equal(mixed.t, np.stack([hits.t for hits in each])[masks, np.arange(len(masks))])
    assert (scene.count(*rays, mask=masks)[masks == 0] == 0).all()
    lists = scene.intersect_all(*rays, mask=wp.array(masks.astype(np.uint32), dtype=wp.uint32, device="cpu"))
    own = np.array([instance.mask for instance in scene.instances])[lists.instance_id]
    assert (own & masks[lists.ray_id]).all()


@pytest.mark.parametrize("accelerator", ["bvh", "kdtree"])
def test_back_faces(accelerator):
    """Culled by every traversal that can, the same way; what comes into a closed surface comes out of it culled."""
    scene = wrt.Scene([BALL, BOX.transformed(move(1.5))], accelerator, device="cpu")
    origins, directions = mixed_rays(scene.flattened(), 3000)
    expected = scene.intersect(origins, directions, cull_backfaces=True, traversal="brute")
    assert expected.plan.cull_backfaces
    for traversal in ("single", "stream") if accelerator == "bvh" else ("single",):
        hits = scene.intersect(origins, directions, cull_backfaces=True, traversal=traversal)
        assert_same_hits(hits, expected)
    assert ((hits.normal[hits.is_hit] * directions[hits.is_hit]).sum(axis=1) < 0).all()
    assert (expected.is_hit < scene.intersect(origins, directions).is_hit).any()
    with pytest.raises(ValueError, match=r"'packet' does not cull .* choose from auto, brute, single"):
        scene.intersect(origins, directions, cull_backfaces=True, traversal="packet")


def test_trimesh_graph():
    """Nodes are instances, in the graph's order, under all maps above them; what is shared is built once."""
    graph = trimesh.Scene()
    ball = trimesh.creation.icosphere(1)
    graph.add_geometry(ball, node_name="one", geom_name="ball", transform=move(3))
    graph.graph.update(frame_from="one", frame_to="two", geometry="ball", matrix=move(0, 4))
    graph.add_geometry(trimesh.creation.box(), node_name="box", transform=np.diag([2.0, 2.0, 2.0, 1.0]))
    graph.add_geometry(trimesh.PointCloud(np.zeros((2, 3))), node_name="cloud")
    scene = wrt.Scene(graph, device="cpu")
    assert len(scene.instances) == 3
    assert len(scene.meshes) == 2
    assert scene.geometry_ids.count(scene.geometry_ids[0]) == 2
    assert scene.triangle_count == 2 * len(ball.faces) + 12
    hits = scene.intersect([[3, 0, 9.0], [3, 4, 9.0], [0.9, 0.9, 9.0], [8, 8, 9.0]], [0, 0, -1.0])
    np.testing.assert_allclose(hits.t, [8, 8, 8, np.inf], atol=1e-5)
    assert sorted(hits.instance_id[:3]) == [0, 1, 2]
    assert hits.instance_id[3] == hits.geometry_id[3] == -1
    with pytest.raises(ValueError, match="no triangles"):
        wrt.Scene(trimesh.Scene(trimesh.PointCloud(np.zeros((2, 3)))))


def test_back_faces_of_a_closed_surface():
    """It is met once from outside, and not from inside; mirrored instances keep their outer side."""
    starts = np.random.default_rng(0).normal(size=(200, 3))
    starts *= 9.0 / np.linalg.norm(starts, axis=1, keepdims=True)
    scene = wrt.Scene(BALL, device="cpu")
    assert (scene.count(starts, -starts, cull_backfaces=True) == 1).all()
    assert (scene.count(0 * starts, starts, cull_backfaces=True) == 0).all()
    mirrored = wrt.Scene([wrt.Instance(BALL, np.diag([-1.0, 2.0, 1.0, 1.0]))], device="cpu")
    assert mirrored.intersect(starts, -starts, cull_backfaces=True).is_hit.all()
    assert not mirrored.intersect(0 * starts, starts, cull_backfaces=True).is_hit.any()


BAD = {
    "mesh": (lambda: wrt.Instance(np.eye(4)), TypeError, "mesh must be a wrt.TriangleMesh or a trimesh.Trimesh"),
    "shape": (lambda: wrt.Instance(BOX, np.eye(3)), ValueError, r"\(4, 4\) matrix, not of shape \(3, 3\)"),
    "nan": (lambda: wrt.Instance(BOX, np.full((4, 4), np.nan)), ValueError, "finite"),
    "perspective": (lambda: wrt.Instance(BOX, np.ones((4, 4))), ValueError, "affine, its last row"),
    "singular": (lambda: wrt.Instance(BOX, FLAT), ValueError, r"singular.*mesh\.transformed"),
    "mask type": (lambda: wrt.Instance(BOX, mask=1.0), TypeError, "mask must be an int, not float"),
    "mask": (lambda: wrt.Instance(BOX, mask=-1), ValueError, "from 0 to"),
    "member": (lambda: wrt.Scene([wrt.Instance(BOX), 7]), TypeError, "mesh must be"),
    "no masks": (lambda: wrt.Scene(BOX).intersect([0, 0, 9], [0, 0, -1.0], mask=1), ValueError, r"mask=\.\.\."),
    "no places": (lambda: wrt.Scene(BOX).update(0, transform=np.eye(4)), ValueError, r"make it from wrt\.Instance"),
    "statistics": (lambda: wrt.Scene([wrt.Instance(BOX)]).statistics(), ValueError, r"wrt\.Scene\(scene\.meshes"),
}
QUERIES = {
    "traversal": ({"traversal": "lockstep"}, "does not walk a bvh"),
    "two levels": ({"traversal": "brute"}, "choose from auto, single, packet, stream"),
    "one origin": ({"triangle_test": "komatsu"}, "needs one origin"),
    "mask shape": ({"mask": [1, 2, 3]}, "does not broadcast"),
    "mask range": ({"mask": -1}, "from 0 to"),
    "counters": ({"traversal": "stream", "counters": True}, "pass traversal='single'"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_scenes(case):
    call, kind, message = BAD[case]
    with pytest.raises(kind, match=message):
        call()


@pytest.mark.parametrize("case", QUERIES)
def test_bad_queries(case):
    options, message = QUERIES[case]
    with pytest.raises(ValueError, match=message):
        wrt.Scene([wrt.Instance(BOX)], device="cpu").intersect([0, 0, 9.0], np.float32([[0, 0, -1], [0, 0, 1]]), **options)
    with pytest.raises(TypeError, match="mask must hold integers"):
        wrt.Scene([wrt.Instance(BOX)], device="cpu").occluded([0, 0, 9.0], [0, 0, -1.0], mask=0.5)


def test_counters():
    hits = wrt.Scene(random_instances(), device="cpu").intersect(np.zeros((500, 3)), np.ones((500, 3)), counters=True)
    assert hits.plan.traversal == "single"
    assert (hits.counters["nodes"] > 0).all()


def test_shapes_and_no_rays(scene):
    hits = scene.intersect(np.zeros((2, 3, 3)), np.ones((2, 3, 3)))
    assert hits.instance_id.shape == hits.t.shape == (2, 3)
    assert scene.intersect(np.zeros((0, 3)), np.ones((0, 3))).t.shape == (0,)
    assert len(scene.intersect_all(np.zeros((0, 3)), np.ones((0, 3)))) == 0


def test_from_many_threads(scene, rays):
    """One scene, several threads at once, each with its own number of threads."""
    expected, problems = scene.intersect(*rays), []

    def work(number: int) -> None:
        try:
            with use_threads(1 + number % 3):
                for _ in range(3):
                    assert_same_hits(scene.intersect(*rays), expected)
        except BaseException as problem:
            problems.append(problem)

    threads = [threading.Thread(target=work, args=(number,)) for number in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not problems


@pytest.mark.parametrize(("kind", "query"), [("bvh", "all"), ("kdtree", "closest")])
def test_compiles_for_cuda(kind, query, tmp_path):
    config = TraversalConfig("woop", 2, query, stack=StackConfig(24, CUDA_BLOCK if kind == "bvh" else 0))
    text = compile_to_ptx(make_instance_kernel(config, kind, 8).module, tmp_path)
    assert ".entry" in text
    assert "fma.rn.f32" not in text


def test_pickles_and_files(tmp_path):
    """Instances go with a pickle, sharing their mesh, and with a file."""
    mesh = wrt.scenes.build("teapot", level=2)
    scene = wrt.Scene([wrt.Instance(mesh), wrt.Instance(mesh, move(5.0), mask=2)], device="cpu")
    revived = pickle.loads(pickle.dumps(scene))
    assert revived.instances
    assert len(revived.state.parts) == 1
    down = np.array([[0.2, 0.1, 9.0], [5.2, 0.1, 9.0]]), (0.0, 0.0, -1.0)
    for mask in (None, 1, 2):
        assert_same_hits(revived.intersect(*down, mask=mask), scene.intersect(*down, mask=mask))
    scene.save(tmp_path / "scene.npz")
    loaded = wrt.Scene.load(tmp_path / "scene.npz", device="cpu")
    assert len(loaded.state.parts) == 1
    for mask in (None, 1, 2):
        assert_same_hits(loaded.intersect(*down, mask=mask), scene.intersect(*down, mask=mask))
    area = wrt.known_rays.PlaneInfluenceArea(position=(0, 0, 9), direction=(0, 0, -1), width=1, height=1, depth=9)
    with pytest.raises(ValueError, match="influence areas"):
        wrt.Scene([wrt.Instance(mesh)], wrt.known_rays.RayAwareBvh(areas=[area]))
