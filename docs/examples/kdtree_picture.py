"""A student's afternoon: three kd-trees of one model, what rays cost in them, a drawing of the best, and a picture in glass.

    python docs/examples/kdtree_picture.py [SIZE]      1 for 320 x 240 pixels

It writes the picture, and the drawing where matplotlib is installed. `docs/reading.md` names five files to read beside it.
"""

import sys
from importlib.util import find_spec
from time import perf_counter

import numpy as np

import wrt

size = float(sys.argv[1]) if len(sys.argv) > 1 else 1.0
pot = wrt.scenes.build("teapot", level=max(3, round(16 * size)), ground=False, closed=True)
camera = wrt.PinholeCamera.framing(pot, max(16, round(320 * size)), max(12, round(240 * size)), up=(0, 0, 1))

trees, rays, answers = {}, camera.rays(), {}
for builder in ("object_median", "spatial_median", "sweep"):
    wrt.Scene(pot, wrt.KdTree(builder=builder))  # compiles what it needs the first time
    begin = perf_counter()
    scene = wrt.Scene(pot, wrt.KdTree(builder=builder))
    seconds = perf_counter() - begin
    hits = scene.intersect(rays, traversal="single", counters=True)
    work, tree = hits.counters, scene.statistics().tree
    nodes, tests = work["nodes"].mean(), work["triangles"].mean()
    trees[builder], answers[builder] = scene, hits.primitive_id
    print(
        f"{builder:14}: {1e3 * seconds:6.1f} ms, {tree.nodes:,} nodes, expected cost {tree.sah_cost:.1f}; "
        f"a ray visits {nodes:.1f} nodes and tests {tests:.1f} triangles"
    )
assert all(np.array_equal(one, answers["sweep"]) for one in answers.values())  # one answer from every tree

if find_spec("matplotlib") is not None:
    import matplotlib

    matplotlib.use("Agg")
    wrt.pictures.draw_tree(trees["sweep"])[0].figure.savefig("tree.png", dpi=100, bbox_inches="tight")

low, high = pot.bounds
checks = wrt.Texture((np.indices((256, 256)) // 32).sum(axis=0) % 2 * 0.6 + 0.2)
ground = wrt.scenes.shapes.plane(low[:2] - 4 * pot.extent, high[:2] + 4 * pot.extent, z=low[2])
uv = (ground.vertices[:, :2] - pot.center[:2]) / pot.extent
glass = wrt.Material("dielectric", index=1.5, color=1.0, absorption=(0.25, 0.05, 0.05))
tiles = wrt.Material("diffuse", color=1.0, color_texture=checks)
scene = wrt.Scene(
    [pot.with_materials(glass), ground.with_materials(tiles, uv=uv)]
)  # a BVH; wrt.KdTree() gives the same picture
lights = [
    wrt.lights.AreaLight.sphere(pot.center + pot.extent * np.array([1, -1, 2]), 0.4 * pot.extent, radiance=25.0),
    wrt.lights.Sky.gradient(horizon=0.6, zenith=(0.2, 0.35, 0.7), ground=0.2),
]
image = wrt.render(scene, camera, integrator="path", samples=max(2, round(32 * size)), lights=lights)
wrt.save_image("glass.png", image)
assert np.isfinite(image).all()
assert image.std() > 0.02
