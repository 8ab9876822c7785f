"""Meshes before they are printed: are they closed, how much do they hold, where are they thin, what hangs over, what is inside?

    python docs/examples/printing.py [SIZE]      1 for bodies of some 200,000 triangles

A good vase, the same with a hole, and two rings through one another.
"""

import sys

import numpy as np

import wrt

size = float(sys.argv[1]) if len(sys.argv) > 1 else 1.0


def ring(radius, tube, count):
    """A closed torus around z."""
    turn = np.linspace(0.0, 2 * np.pi, max(12, count // 2) + 1)
    profile = np.stack([radius + tube * np.cos(turn), tube * np.sin(turn)], axis=-1)
    profile[-1] = profile[0]
    return wrt.scenes.shapes.lathe(profile, max(16, count))


def vase(count, wall=2.0):
    """A closed vase of a height of 100, its walls and its floor of a thickness."""
    z = np.linspace(0.0, 100.0, max(8, count // 4))
    outside = 30.0 + 12.0 * np.sin(z / 9.0)
    inside = np.stack([outside - wall, z], axis=-1)[z > wall]
    axis = np.array([[0.0, wall]]), np.array([[0.0, 0.0]])
    profile = np.concatenate([axis[1], np.stack([outside, z], axis=-1), inside[::-1], axis[0]])
    return wrt.scenes.shapes.lathe(profile, max(16, count))


count = max(24, round(450 * size**0.5))
good = vase(count)
leaky = wrt.TriangleMesh(good.vertices, good.faces[50:])
around = ring(30.0, 5.0, count)
across = around.transformed([[1, 0, 0, 6], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
chain = wrt.TriangleMesh.concatenate([around, across])

found = {}
for name, mesh in {"vase": good, "leaky": leaky, "chain": chain}.items():
    scene = wrt.Scene(mesh)
    counts = mesh.summary()
    faces = scene.points_on(np.arange(mesh.triangle_count))
    wall = wrt.analysis.thickness(scene, faces)
    low, high = mesh.bounds
    down = mesh.face_normals[:, 2] < -np.cos(np.radians(45.0))
    hangs = down & (faces.position[:, 2] > low[2] + 0.1)  # what lies on the bed needs no support
    a, b, c = np.moveaxis(mesh.vertices[mesh.faces] - mesh.center, 1, 0)
    volume = np.einsum("ij,ij->", a, np.cross(b, c)) / 6.0
    inner = mesh.bounds[0] + np.random.default_rng(0).random((max(2000, round(200_000 * size)), 3)) * (high - low)
    inside = scene.contains(inner)
    found[name] = {
        "closed": counts["is_closed"],
        "degenerate": counts["degenerate_triangles"],
        "volume": volume,
        "inside": inside.mean() * np.prod(high - low),
        "thinnest": float(np.nanpercentile(wall, 1)),
        "overhang": float(np.linalg.norm(np.cross(b - a, c - a), axis=1)[hangs].sum() / 2),
    }
    print(f"{name}, {mesh.triangle_count:,} triangles:", ", ".join(f"{key} {value:,.4g}" for key, value in found[name].items()))

meet = wrt.analysis.overlapping_triangles(wrt.Scene([around, across]), 0, 1)
print(f"{len(meet):,} pairs of triangles of the two rings cut each other: the union has another volume")

assert [one["closed"] for one in found.values()] == [True, False, True]
assert abs(found["vase"]["inside"] / found["vase"]["volume"] - 1) < 0.15
assert 1.0 < found["vase"]["thinnest"] < 2.0  # 2 across, and less where the wall leans
assert found["vase"]["overhang"] > 0.0
assert len(meet)
