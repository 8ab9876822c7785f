"""Hours of sun on the floor of a court: sums over shadow rays, in a folder from which the job goes on if it is interrupted.

python docs/examples/sun_sums.py [SIZE]        1 for 60,000 places and 100 times, 6 M rays
"""

import sys
import tempfile
from pathlib import Path

import numpy as np

import wrt

size = float(sys.argv[1]) if len(sys.argv) > 1 else 1.0
court = wrt.scenes.build("atrium", detail=2)
scene = wrt.Scene(court)

low, high = court.bounds
x, y = np.meshgrid(
    np.linspace(low[0], high[0], max(6, round(300 * size))), np.linspace(low[1], high[1], max(4, round(200 * size)))
)
floor = scene.intersect(np.stack([x, y, np.full_like(x, high[2] + 1.0)], axis=-1), [0.0, 0.0, -1.0])
points = floor.position[floor.is_hit] + [0.0, 0.0, 1e-3]

turn = np.linspace(-1.2, 1.2, max(4, round(100 * size)))
suns = np.stack([np.sin(turn), 0.4 * np.ones_like(turn), np.cos(turn)], axis=-1)

with tempfile.TemporaryDirectory() as folder:
    blocks = scene.occluded_blocks(points, suns[:, None], reduce="sum", axis=0)  # rays of one sun are neighbours
    wrt.cluster.Job(Path(folder) / "sun", blocks).run(most=1)  # interrupted after a block
    dark = wrt.cluster.Job(Path(folder) / "sun", blocks).run().result()  # goes on

lit = 1.0 - dark / len(suns)
quarters = np.arange(len(suns)) * 4 // len(suns) == np.arange(4)[:, None]
shares = wrt.analysis.exposure(scene, floor, suns, weights=quarters / len(suns))  # (rows, columns, 4), of the day's quarters
print(f"{len(points):,} places; the mean share of the day in the sun is {lit.mean():.2f}")
assert np.abs(shares[floor.is_hit].sum(axis=-1) - lit).mean() < 0.01
assert 0.0 < lit.mean() < 1.0
