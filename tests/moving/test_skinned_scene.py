"""Skins over bones: the hits of a fresh tree in every pose, and boxes that hold the poses that joints allow."""

from __future__ import annotations

import copy

import numpy as np
import pytest
import trimesh
from support.hits import assert_same_hits, mixed_rays

import wrt
from wrt.meshes.skeleton import skinned

WALK = wrt.scenes.walking_figure(frames=6, detail=6)
SKIN = WALK.skin

BROKEN = SKIN.skeleton.maps(np.eye(len(SKIN.skeleton))[9][:, None] * [0.0, 150.0, 0.0])
"""A forearm turned backwards."""


def scene_of(**options) -> wrt.moving.SkinnedScene:
    return wrt.moving.SkinnedScene(SKIN.vertices, WALK.faces, SKIN.weights, SKIN.skeleton, device="cpu", **options)


def assert_as_fresh(scene: wrt.moving.SkinnedScene) -> None:
    fresh = wrt.Scene(scene.meshes, device="cpu")
    rays = mixed_rays(scene.flattened(), 800)
    hits = scene.intersect(*rays)
    assert hits.is_hit.sum() >= 20
    assert_same_hits(hits, fresh.intersect(*rays, traversal="single"))
    np.testing.assert_array_equal(scene.bounds, fresh.bounds)


def test_skeleton_as_turns():
    """A bone's map is its turn about the joint, after the x, the y and the z axis, on top of its parent's."""
    skeleton = SKIN.skeleton
    angles = skeleton.sample(3, seed=4)
    maps = skeleton.maps(angles)
    assert maps.shape == (3, len(skeleton), 4, 4)
    for bone in (0, 1, 3):
        x, y, z = np.radians(angles[2, bone])
        turn = trimesh.transformations.euler_matrix(x, y, z, "sxyz")
        turn[:3, 3] = skeleton.joints[bone] - turn[:3, :3] @ skeleton.joints[bone]
        parent = skeleton.parents[bone]
        np.testing.assert_allclose(maps[2, bone], turn if parent < 0 else maps[2, parent] @ turn, atol=1e-12)
    assert ((angles >= skeleton.limits[..., 0]) & (angles <= skeleton.limits[..., 1])).all()
    assert (angles[0] == 0.0).all()
    np.testing.assert_allclose(skinned(SKIN.vertices, SKIN.weights, maps[0]), SKIN.vertices, atol=1e-12)


def test_the_animation_is_its_skin():
    for frame in (0, 3):
        np.testing.assert_allclose(skinned(SKIN.vertices, SKIN.weights, WALK.bones[frame]), WALK.frames[frame], atol=1e-12)


@pytest.mark.parametrize("tree", [wrt.Bvh(), wrt.KdTree()], ids=["bvh", "kdtree"])
def test_every_pose_as_a_fresh_tree(tree):
    """The walk, which was not known; other poses within the limits; and one that breaks an arm."""
    scene = scene_of(accelerator=tree)
    assert_as_fresh(scene)
    assert scene.grown == 0
    nodes = scene.tree.parts.primitive
    for frame in (1, 4):
        scene.pose(WALK.bones[frame])
        assert scene.grown == 0
        assert_as_fresh(scene)
    for angles in SKIN.skeleton.sample(3, seed=7)[1:]:
        scene.pose(SKIN.skeleton.maps(angles))
        assert_as_fresh(scene)
    if scene.grown == 0:
        assert scene.tree.parts.primitive is nodes
    scene.pose(BROKEN)
    assert scene.grown > 0
    assert_as_fresh(scene)
    scene.pose(WALK.bones[2])
    assert scene.grown == 0
    assert_as_fresh(scene)


def test_boxes_are_small_and_hold_most_poses():
    """Few triangles leave boxes that were made from other poses; and boxes are far smaller than the figure."""
    scene, left = scene_of(), []
    for angles in SKIN.skeleton.sample(20, seed=9)[1:]:
        fresh = copy.copy(scene)
        fresh.pose(SKIN.skeleton.maps(angles))
        left.append(fresh.grown)
    assert np.mean(left) < 0.01 * len(WALK.faces)
    assert scene.grown == 0
    sizes = (scene._boxes.high - scene._boxes.low).max(axis=1)
    assert np.median(sizes) < 0.3 * np.ptp(SKIN.vertices, axis=0).max()


def test_a_copy_grows_alone():
    """Both had shared their boxes: what one enlarged, the other took for granted without having the tree."""
    scene = scene_of()
    other = copy.copy(scene)
    scene.pose(BROKEN)
    other.pose(BROKEN)
    assert scene.grown == other.grown > 0
    assert_as_fresh(other)


BAD = {
    "weights": (
        lambda: wrt.moving.SkinnedScene(SKIN.vertices, WALK.faces, SKIN.weights[:, 1:], SKIN.skeleton),
        "vertices by bones",
    ),
    "sums": (lambda: wrt.moving.SkinnedScene(SKIN.vertices, WALK.faces, 2 * SKIN.weights, SKIN.skeleton), "sum to 1"),
    "samples": (lambda: scene_of(samples=0), "samples is 0"),
    "bones": (lambda: scene_of().pose(np.eye(4)[None]), "1 bones, but the skeleton has 10"),
    "shape": (lambda: scene_of().pose(np.eye(4)), r"\(1, B, 4, 4\)"),
    "update": (lambda: scene_of().update(0, vertices=SKIN.vertices), r"pose\(maps\)"),
    "parents": (lambda: wrt.moving.Skeleton([0], np.zeros((1, 3)), np.zeros((1, 3, 2))), "come before"),
    "limits": (lambda: wrt.moving.Skeleton([-1], np.zeros((1, 3)), np.array([[(1, 0)] * 3])), "must not exceed"),
    "joints": (lambda: wrt.moving.Skeleton([-1], np.zeros(3), np.zeros((1, 3, 2))), "shapes"),
    "angles": (lambda: SKIN.skeleton.maps(np.zeros(3)), r"\.\.\., 10, 3"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_input(case):
    call, message = BAD[case]
    with pytest.raises(ValueError, match=message):
        call()
