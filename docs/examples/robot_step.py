"""A robot's step: two depth cameras and a lidar see a cell of 20 instances, and what they saw goes to tables and a file.

    python docs/examples/robot_step.py [SIZE]      1 for 64 x 1024 beams and 640 x 480 pixels

Every step has other poses. Layers that nobody reads are not computed.
"""

import sys
import tempfile
from pathlib import Path
from time import perf_counter

import numpy as np

import wrt

size = float(sys.argv[1]) if len(sys.argv) > 1 else 1.0


def placed(mesh, scale, at):
    """An instance, scaled along the axes and moved."""
    matrix = np.diag([*scale, 1.0])
    matrix[:3, 3] = at
    return wrt.Instance(mesh, matrix)


box = wrt.scenes.shapes.boxes([[-0.5] * 3], [[0.5] * 3])
pot = wrt.scenes.build("teapot", level=8, ground=False)
floor, wall = placed(box, (20, 20, 0.2), (0, 0, -0.1)), placed(box, (0.2, 20, 4), (8, 0, 2))
machines = [placed(pot, (0.4, 0.4, 0.4), (2.0 + i, (-1.0) ** i * 2.0, 0.0)) for i in range(5)]
crates = [placed(box, (0.8, 0.6, 0.5), (1.5 + 0.45 * i, 3.5 * np.sin(2.1 * i), 0.25)) for i in range(13)]
scene = wrt.Scene([floor, wall, *machines, *crates])
labels = np.array([0, 0, 1, 1, 1, 2, 2] + [3] * 13)  # the class of each instance

width, height = max(8, round(640 * size)), max(6, round(480 * size))
lens = wrt.sensors.BrownConrady(0.8 * width, 0.8 * width, (width - 1) / 2, (height - 1) / 2)
camera = wrt.sensors.Camera(width, height, lens)
lidar = wrt.sensors.Lidar.preset("ouster_os1_64", columns=max(8, round(1024 * size)))

with tempfile.TemporaryDirectory() as folder:
    for step in range(3):
        begin = perf_counter()
        x = 0.05 * step
        seen = []
        for side in (-0.3, 0.3):
            pose = wrt.sensors.look_at([x, side, 1.2], [x + 4.0, side, 0.6])
            images = camera.capture(scene, pose, labels=labels, layers=("depth", "semantic_id"))
            seen.append((images.depth, images.semantic_id))
        pose = np.eye(4)
        pose[:3, 3] = x, 0.0, 1.5
        table = lidar.scan(scene, pose, labels=labels, seed=step).to_structured("world")
        wrt.sensors.write_points(Path(folder) / f"scan{step}.ply", table)
        print(f"step {step}: {len(table):,} points, {1e3 * (perf_counter() - begin):.1f} ms")

assert len(scene.instances) == 20
assert table.dtype.names[-1] == "semantic_id"
assert (seen[0][1] == 1).any()
