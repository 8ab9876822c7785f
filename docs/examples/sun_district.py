"""Hours of sun in a district of 300 buildings: sums over shadow rays, in a folder from which the job can be resumed, and a map.

    python docs/examples/sun_district.py [SIZE]      1 for 300 buildings, 420 suns and 1 m a pixel, some 70 M rays

It writes the hours of the year, those of the four seasons, and a picture of the map. A tenth of the size takes seconds.
"""

import sys
import tempfile
from pathlib import Path

import numpy as np

import wrt

size = float(sys.argv[1]) if len(sys.argv) > 1 else 1.0
rng = np.random.default_rng(3)
columns, rows = max(3, round(20 * size)), max(2, round(15 * size))
corner = 26.0 * np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1).reshape(-1, 2)
low = np.pad(corner + rng.uniform(0, 6, corner.shape), ((0, 0), (0, 1)))
high = low + np.stack([*rng.uniform(10, 18, (2, len(low))), rng.uniform(6, 24, len(low))], axis=-1)
blocks = wrt.scenes.shapes.boxes(low, high)
street = wrt.scenes.shapes.plane((-20.0, -20.0), tuple(high[:, :2].max(axis=0) + 20.0), z=0.0)
scene = wrt.Scene([blocks, street])

pixel = 1.0 / min(1.0, 4 * size)  # metres
x, y = (np.arange(-10.0, end, pixel) for end in high[:, :2].max(axis=0) + 10.0)
above = np.stack([*np.meshgrid(x, y[::-1]), np.full((len(y), len(x)), 100.0)], axis=-1)
ground = scene.intersect(above, [0.0, 0.0, -1.0])  # roofs and streets, north up
places = ground.position.reshape(-1, 3) + np.array([0.0, 0.0, 1e-3])

declination = np.radians(-23.4) * np.cos(2 * np.pi * np.arange(12) / 12)  # of each month, from December 21 on
hour = np.radians(15.0) * np.linspace(-8.0, 8.0, max(5, round(65 * size)))
latitude = np.radians(50.0)
d, h = (one.ravel() for one in np.meshgrid(declination, hour, indexing="ij"))
suns = np.stack(
    [
        -np.cos(d) * np.sin(h),
        np.cos(latitude) * np.sin(d) - np.sin(latitude) * np.cos(d) * np.cos(h),
        np.sin(latitude) * np.sin(d) + np.cos(latitude) * np.cos(d) * np.cos(h),
    ],
    axis=-1,
)
up = suns[:, 2] > 0.02
hours = 16.0 / (len(hour) - 1) * 365.25 / 12  # that a sun stands for
month = np.repeat(np.arange(12), len(hour))[up]
suns = suns[up].astype(np.float32)
seasons = hours * np.stack([month // 3 == season for season in range(4)])  # (4, D)

with tempfile.TemporaryDirectory() as folder:
    hidden = scene.occluded_blocks(
        places, suns[:, None], reduce=wrt.batches.WeightedSum(seasons), axis=0, memory="64 MB", progress=size >= 0.3
    )
    wrt.cluster.Job(Path(folder) / "sun", hidden).run(most=1)  # interrupted after a block
    dark = wrt.cluster.Job(Path(folder) / "sun", hidden).run().result()  # (places, 4); the other blocks

lit = (seasons.sum(axis=1) - dark).reshape(*ground.shape, 4)
np.save("sun_hours.npy", lit.astype(np.float32))
year = lit.sum(axis=-1) / seasons.sum()
wrt.save_image("sun_hours.png", np.stack([year, year**1.5, 0.4 * (1 - year)], axis=-1).astype(np.float32))
print(f"{len(blocks.faces) // 12} buildings, {len(places):,} places, {len(suns)} suns, {len(places) * len(suns):,} rays")
print(f"hours of sun, of {seasons.sum():,.0f}: streets {lit[ground.geometry_id == 1].sum(axis=-1).mean():,.0f}, ", end="")
print(f"roofs {lit[ground.geometry_id == 0].sum(axis=-1).mean():,.0f}")

shares = wrt.analysis.exposure(scene, ground, suns, weights=seasons)  # the same at once, without a folder
assert np.abs(shares - lit).mean() < 0.01 * lit.mean()
assert lit[ground.geometry_id == 0].mean() > lit[ground.geometry_id == 1].mean()
