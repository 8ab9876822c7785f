"""2,048 environments of a simulation: in each, bodies of its own that move, and a scanner; ranges and heights for all at once.

    python docs/examples/environments.py [SIZE]      1 for 2,048 environments

What a policy is trained with: a step moves every body and measures every sensor in one call each.
"""

import sys
from time import perf_counter

import numpy as np

import wrt

size = float(sys.argv[1]) if len(sys.argv) > 1 else 1.0
count, bodies = max(4, round(2048 * size)), 3
rng = np.random.default_rng(0)

box = wrt.scenes.shapes.boxes([[-0.5] * 3], [[0.5] * 3])
ground = wrt.scenes.shapes.plane((-20.0, -20.0), (20.0, 20.0), z=0.0)
places = np.tile(np.eye(4), (count, bodies, 1, 1))
turn = rng.uniform(0, 2 * np.pi, (count, bodies))
far = rng.uniform(1.5, 6.0, (count, bodies))
places[..., :2, 3] = far[..., None] * np.stack([np.cos(turn), np.sin(turn)], axis=-1)
places[..., 2, 3] = 0.5
owner = np.repeat(np.arange(count), bodies)
instances = [wrt.Instance(box, place, environment=int(k)) for k, place in zip(owner, places.reshape(-1, 4, 4), strict=True)]
scene = wrt.Scene([wrt.Instance(ground), *instances])  # the ground, instance 0, is in all of them
index = np.arange(1, 1 + len(instances))

azimuth = np.linspace(-np.pi, np.pi, 64, endpoint=False)
fan = np.stack([np.cos(azimuth), np.sin(azimuth), 0 * azimuth], axis=-1)
scanner = wrt.sensors.Lidar(pattern=wrt.sensors.LidarPattern(fan, times=np.zeros(64)), min_range=0.1, max_range=10.0)
poses = np.tile(np.eye(4), (count, 1, 1))
poses[:, 2, 3] = 0.4
x, y = np.meshgrid(np.linspace(-1, 1, 9), np.linspace(-1, 1, 9))
grid = np.stack([x, y, np.full_like(x, 3.0)], axis=-1).reshape(1, -1, 3)  # a height scan around each robot

for step in range(3):
    begin = perf_counter()
    poses[:, 0, 3] += 0.05
    places[..., 1, 3] += rng.normal(0, 0.02, (count, bodies))
    scene.update(index, transform=places.reshape(-1, 4, 4))
    worlds = np.arange(count)
    ranges = scanner.scan(scene, poses, environment=worlds).range  # (count, 64)
    hits = scene.intersect(grid + poses[:, None, :3, 3] * [1, 1, 0], [0.0, 0.0, -1.0], environment=worlds[:, None])
    heights = 3.0 - hits.t  # (count, 81)
    took = perf_counter() - begin
    print(f"step {step}: {count:,} environments, {ranges.size + heights.size:,} rays, {1e3 * took:.1f} ms")

assert (ranges.shape, heights.shape) == ((count, 64), (count, 81))
assert set(np.unique(heights.round(3))) <= {0.0, 1.0}  # the ground, or a box
assert np.isfinite(ranges).any()
