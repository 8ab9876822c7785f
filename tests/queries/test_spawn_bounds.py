"""How far spawned origins are from their hits, and what rays from there see: long triangles, scales, corners, instances.

Origins were once moved by a term L^2 / h off a triangle of length L and height h, and away from its edges as far as it took. On
a road of two triangles, 1000 x 1 m, half of them moved by more than 41 m, and streets saw too much of the sky.
"""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pytest
import trimesh

import wrt

OFFSET, BOUND = 2.0**-21, 6.7e-6
"""Distance of an origin from the plane of its triangle, and bound of that from its hit, as fractions of the reach."""

UTM = np.array([5e5, 5e6, 300.0])


def strip(length, width, angle=0.0):
    """Two triangles in the plane z = 0, centred, turned around z."""
    c, s = np.cos(angle), np.sin(angle)
    corners = np.array([[-length, -width], [length, -width], [length, width], [-length, width]]) / 2 @ [[c, s], [-s, c]]
    return np.c_[corners, np.zeros(4)], np.array([[0, 1, 2], [0, 2, 3]])


def on_surface(scene, count, seed=0, spread=0.4):
    """Points all over the triangles, many of them near edges and vertices."""
    rng = np.random.default_rng(seed)
    weights = rng.dirichlet([spread] * 3, count)
    return scene.points_on(rng.integers(0, scene.triangle_count, count), weights[:, 1:])


def towards(hits, seed=0, grazing=1e-9):
    """A direction for each hit, to the front or back, at angles down to `grazing`."""
    rng = np.random.default_rng(seed)
    normals = hits.normal.astype(np.float64)
    tangents = np.cross(normals, rng.normal(size=normals.shape))
    tangents /= np.linalg.norm(tangents, axis=-1, keepdims=True)
    slope = 10.0 ** rng.uniform(np.log10(grazing), 1, (*hits.shape, 1)) * rng.choice([-1.0, 1.0], (*hits.shape, 1))
    return (tangents + slope * normals).astype(np.float32)


def reach_of(scene, points):
    low, high = scene.bounds
    return np.maximum(np.abs(points - low), np.abs(points - high)).max(axis=-1)


@pytest.mark.parametrize("place", [np.zeros(3), UTM], ids=["near", "UTM"])
@pytest.mark.parametrize("scale", [1e-4, 1.0, 100.0, 1e7])
def test_origins_are_near_their_hits(scale, place):
    """Two triangles of aspect ratios from 1 to a million: a bound in units of the reach, no triangle met again, and the side
    that it should be."""
    if scale < 1.0:
        place = place * 1e-3  # of a tenth of a millimetre, float64 has no digits left at UTM coordinates
    for aspect, angle in itertools.product((1, 30, 1e3, 1e6), (0.0, 0.7)):
        points, faces = strip(scale, scale / aspect, angle)
        scene = wrt.Scene(wrt.TriangleMesh(points + place, faces))
        hits = on_surface(scene, 3000)
        directions = towards(hits)
        origins = hits.spawn(directions)
        moved = np.linalg.norm(origins - hits.position, axis=1)
        reach = reach_of(scene, hits.position)
        rounding = 4.0 * np.spacing(np.abs(place).max())
        assert (moved <= 1.001 * BOUND * reach + rounding).all(), (aspect, (moved / reach).max())
        height = (origins - place)[:, 2] * np.where(directions[:, 2] < 0, -1.0, 1.0)
        np.testing.assert_allclose(height, OFFSET * reach, rtol=1e-3, atol=rounding)
        again = scene.intersect(origins, directions)
        assert not (again.primitive_id == hits.primitive_id).any(), (aspect, "own triangle")
        assert not again.is_hit.any(), (aspect, "the other triangle of the same plane")


def inset_of(scene, hits, directions):
    """Distances from the three edges of points on triangles, before and after rays have left them, in offsets."""
    corners = scene.meshes[0].vertices[scene.meshes[0].faces[hits.primitive_id]]
    edges = np.roll(corners, -1, axis=1) - corners
    inward = np.cross(hits.normal[:, None].astype(np.float64), edges)
    inward /= np.linalg.norm(inward, axis=-1, keepdims=True)
    offset = (OFFSET * reach_of(scene, hits.position))[:, None]
    return [((at[:, None] - corners) * inward).sum(axis=-1) / offset for at in (hits.position, hits.spawn(directions))]


def test_tips_of_triangles():
    """Points at the tip of a corner of angle A are moved 7 sin^2 A offsets away from both edges, those at one edge 7."""
    for angle, expected in ((90.0, 7.0), (60.0, 5.25), (45.0, 3.5), (10.0, 0.211)):
        corners = np.array([[0, 0, 0], [1, 0, 0], [np.cos(np.radians(angle)), np.sin(np.radians(angle)), 0]])
        scene = wrt.Scene(wrt.TriangleMesh(corners, [[0, 1, 2]]))
        hits = scene.points_on(0, [[0.0, 0.0], [0.5, 0.0], [0.0, 0.5]])
        after = inset_of(scene, hits, np.array([0, 0, 1.0]))[1]
        np.testing.assert_allclose(after[0, [0, 2]], expected, rtol=0.01)
        np.testing.assert_allclose([after[1, 0], after[2, 2]], 7.0, rtol=0.01)


def test_needles_thinner_than_the_inset():
    """Points of a triangle a millionth as high as long stay within it, and move by less than its height."""
    for high in (3e-6, 1e-6, 1e-8):
        scene = wrt.Scene(wrt.TriangleMesh([[0, 0, 0], [1, 0, 0], [0.5, high, 0]], [[0, 1, 2]]))
        hits = on_surface(scene, 500)
        after = inset_of(scene, hits, np.array([0, 0, 1.0]))[1]
        assert (after > -1e-3).all(), high
        moved = np.linalg.norm((hits.spawn([0, 0, 1.0]) - hits.position)[:, :2], axis=1)
        assert moved.max() < 3.0 * high


def test_instances_that_are_stretched():
    """Rays are rounded in the space of the geometry: where that is long in one direction and is pressed in it, and short in
    another one and is stretched, rounding is far coarser than in the scene, and the offset is doubled until it is enough."""
    ball = trimesh.creation.icosphere(2)
    turn = trimesh.transformations.rotation_matrix(0.6, [1, 2, 3])
    places = [((1, 1, 1), False), ((1e4, 1e4, 1e4), False), ((1e3, 1, 1e-3), False), ((32, 1, 1 / 32), True)]
    for scales, is_round in places:
        transform = np.diag([*scales, 1.0]) @ turn.T
        transform[:3, 3] = [3, -2, 1]
        vertices = ball.vertices / scales @ turn[:3, :3].T if is_round else ball.vertices
        scene = wrt.Scene([wrt.Instance(wrt.TriangleMesh(vertices, ball.faces), transform)])
        hits = on_surface(scene, 4000)
        directions = towards(hits, grazing=1e-6)
        again = scene.intersect(hits.spawn(directions), directions)
        own = again.is_hit & (again.primitive_id == hits.primitive_id)
        assert not own.any(), (scales, own.sum())


HARDEST = np.load(Path(__file__).with_name("hardest_spawns.npy"))
"""(N, 14) three corners, two weights and a direction: rays that meet their triangle from offsets of 8 to 8.75 roundings, u R in
`wrt.kernels.query.spawn`. Found by a search that climbs, from 20,000 random triangles on."""


def test_steep_rays_whose_rounding_adds_up():
    """Where all roundings have the same sign, a steep ray meets its triangle from where others do not: from a quarter of the
    offset, and some from the whole of it. These are moved farther."""
    met = {0.25: 0, 1.0: 0}
    for row in HARDEST:
        scene = wrt.Scene(wrt.TriangleMesh(row[:9].reshape(3, 3), [[0, 1, 2]]))
        hits, direction = scene.points_on([0], row[9:11]), row[11:].astype(np.float32)
        normal = np.where(hits.faces(direction), 1.0, -1.0)[:, None] * hits.normal
        offset = OFFSET * reach_of(scene, hits.position)
        origin = hits.spawn(direction)
        assert ((origin - hits.position) * normal).sum() >= 0.999 * offset[0]
        assert not scene.occluded(origin, direction).any()
        for share in met:
            met[share] += int(scene.occluded(hits.position + share * offset[:, None] * normal, direction).sum())
    assert min(met.values()) > 0, met


# -- walls -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("place", [np.zeros(3), UTM], ids=["near", "UTM"])
def test_a_wall_at_a_millimetre(place):
    """Three walls of 100 x 100 m, and of 100 x 1 m, a millimetre apart: rays from the middle one meet the others."""
    rng = np.random.default_rng(2)
    for width in (100.0, 1.0):
        points, faces = strip(100.0, width, 0.3)
        walls = np.concatenate([points + gap * np.array([0, 0, 1]) for gap in (-1e-3, 0.0, 1e-3)])
        scene = wrt.Scene(wrt.TriangleMesh(walls + place, np.concatenate([faces + 4 * i for i in range(3)])))
        weights = 0.02 + 0.98 * rng.dirichlet([1.0] * 2, (4000, 2))[..., 0]
        weights[:1000, 1] = weights[:1000, 0]  # on the diagonal
        here = (0.96 * weights[:, :1]) * (points[1] - points[0]) + (0.96 * weights[:, 1:]) * (points[3] - points[0])
        hits = scene.intersect(points[0] + here + [0, 0, 0.5e-3] + place, [0, 0, -1])
        assert set(hits.primitive_id // 2) == {1}
        for side, expected in ((1.0, 2), (-1.0, 0)):
            directions = np.c_[rng.uniform(-3, 3, (4000, 2)), np.full(4000, side)]
            again = scene.intersect(hits.spawn(directions), directions)
            assert set(again.primitive_id // 2) == {expected}


def wedge(degrees, length):
    """A closed body of triangular section with an edge of this angle along y, from which two faces of length 1 go."""
    x, z = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    section = np.array([[0, 0, 0], [1, 0, 0], [x, 0, z]], dtype=float)
    points = np.concatenate([section + length * np.array([0, at, 0]) for at in (-0.5, 0.5)])
    return trimesh.Trimesh(points, [[0, 4, 1], [0, 3, 4], [1, 5, 2], [1, 4, 5], [2, 3, 0], [2, 5, 3], [0, 1, 2], [3, 5, 4]])


@pytest.mark.parametrize("length", [1.0, 100.0])
@pytest.mark.parametrize("degrees", [90.0, 45.0, 10.0])
def test_corners_keep_what_is_in_them(degrees, length):
    """From points down to a hundred millionth from the edge of a closed body, no ray gets out, and none starts outside."""
    body = wedge(degrees, length)
    scene = wrt.Scene(wrt.TriangleMesh(body.vertices, body.faces))
    rng = np.random.default_rng(3)
    count = 20_000
    away, along = 10.0 ** rng.uniform(-8, -0.1, count), rng.uniform(0.05, 0.95, count)
    weight0, weight3 = (1 - away) * (1 - along), (1 - away) * along
    for face, uv in ((1, (weight3, away)), (4, (weight3, weight0))):  # both have the edge from vertex 0 to 3
        hits = scene.points_on(face, np.stack(uv, axis=-1))
        directions = rng.normal(size=(count, 3))
        directions = np.where(hits.faces(directions)[:, None], -directions, directions)
        origins = hits.spawn(directions)
        heights = ((origins[:, None] - body.triangles[:, 0]) * body.face_normals).sum(axis=-1)
        assert (heights < 0.0).all(), f"{(heights >= 0.0).any(axis=1).sum()} origins lie outside"
        out = ~scene.occluded(origins, directions)
        assert not out.any(), f"{out.sum()} rays got out"


# -- the sky -----------------------------------------------------------------------------------------------------------


def sky_share(scene, hits, samples=1024):
    """(...) cosine-weighted share of directions around z that leave the scene, by a spiral of directions."""
    radius, turn = np.sqrt((np.arange(samples) + 0.5) / samples), np.pi * (3.0 - np.sqrt(5.0)) * np.arange(samples)
    sky = np.c_[radius * np.cos(turn), radius * np.sin(turn), np.sqrt(1 - radius**2)].astype(np.float32)
    directions = np.broadcast_to(sky.reshape(samples, *[1] * len(hits.shape), 3), (samples, *hits.shape, 3))
    return (hits.faces(directions) & ~scene.occluded(hits.spawn(directions), directions)).mean(axis=0)


def canyon(length, width, height):
    """A street between two walls, each of two triangles."""
    floor, faces = strip(length, width)
    wall = np.array([[-length / 2, 0, 0], [length / 2, 0, 0], [length / 2, 0, height], [-length / 2, 0, height]])
    points = np.concatenate([floor, *(wall + width * np.array([0, at, 0]) for at in (-0.5, 0.5))])
    return wrt.Scene(wrt.TriangleMesh(points, np.concatenate([faces, faces + 4, faces + 8])))


def view_of_wall(height, length, distance):
    """View factor of a rectangle from a small area that is perpendicular to it, level with a lower corner, at this distance."""
    far = np.hypot(height, distance)
    return (np.arctan2(length, distance) - distance / far * np.arctan(length / far)) / (2 * np.pi)


@pytest.mark.parametrize("length", [100.0, 1000.0])
def test_sky_of_a_canyon(length):
    """Each point against the closed form of a street of this length, and the mean against that of an infinite one: Hottel's
    crossed strings give sqrt(1 + (H/W)^2) - H/W."""
    for width, height in ((1.0, 0.9), (10.0, 30.0)):
        scene = canyon(length, width, height)
        across, along = np.linspace(-0.49, 0.49, 41)[:, None] * width, np.linspace(-0.45, 0.45, 9) * length
        points = np.stack(np.broadcast_arrays(across, along, 1e-3), axis=-1)[..., [1, 0, 2]]
        hits = scene.intersect(points, [0, 0, -1])
        found = sky_share(scene, hits)
        ends, sides = (length / 2 - along, length / 2 + along), (width / 2 - across, width / 2 + across)
        expected = 1.0 - sum(view_of_wall(height, end, side) for end in ends for side in sides)
        np.testing.assert_allclose(found, expected, atol=0.012)
        assert abs((found - expected).mean()) < 0.002
        if length / height > 500:
            assert abs(found.mean() - (np.hypot(1, height / width) - height / width)) < 0.006


def test_sky_of_a_slope():
    """The front of a free slope sees 1 - T / 180 of the sky by solid angle, (1 + cos T) / 2 by the cosine to the vertical."""
    height = (np.arange(512) + 0.5) / 512
    turn, level = np.pi * (3.0 - np.sqrt(5.0)) * np.arange(512), np.sqrt(1 - height**2)
    sky = np.c_[level * np.cos(turn), level * np.sin(turn), height].astype(np.float32)[:, None]
    for degrees in (0.0, 45.0, 80.0):
        points, faces = strip(100.0, 1.0)
        tilt = trimesh.transformations.rotation_matrix(np.radians(degrees), [1, 0, 0])[:3, :3]
        scene = wrt.Scene(wrt.TriangleMesh(points @ tilt.T, faces))
        hits = on_surface(scene, 256)
        assert abs(sky_share(scene, hits, 512).mean() - (1 + np.cos(np.radians(degrees))) / 2) < 0.01
        towards_sky = np.broadcast_to(sky, (512, 256, 3))
        seen = hits.faces(towards_sky) & ~scene.occluded(hits.spawn(towards_sky), towards_sky)
        assert abs(seen.mean() - (1 - degrees / 180)) < 0.01
