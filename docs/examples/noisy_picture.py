"""A picture whose noisy pixels get more samples, and the same calmed by Open Image Denoise where that is installed.

    python docs/examples/noisy_picture.py [SIZE]      1 for 320 x 240 pixels

It writes where the samples went, too.
"""

import sys
from importlib.util import find_spec

import numpy as np

import wrt

size = float(sys.argv[1]) if len(sys.argv) > 1 else 1.0
pot = wrt.scenes.build("teapot", level=max(3, round(12 * size)), ground=False, closed=True)
low, high = pot.bounds
glass = wrt.Material("dielectric", index=1.5, color=1.0, absorption=(0.25, 0.05, 0.05))
ground = wrt.scenes.shapes.plane(low[:2] - 6 * pot.extent, high[:2] + 6 * pot.extent, z=low[2])
scene = wrt.Scene([pot.with_materials(glass), ground.with_materials(wrt.Material(color=0.6))])
camera = wrt.PinholeCamera.framing(pot, max(16, round(320 * size)), max(12, round(240 * size)), up=(0, 0, 1))
lamp = wrt.lights.AreaLight.sphere(pot.center + pot.extent * np.array([1, -1, 2]), 0.4 * pot.extent, radiance=25.0)
lights = [lamp, wrt.lights.Sky.gradient(horizon=0.6, zenith=(0.2, 0.35, 0.7), ground=0.2)]

picture = wrt.pictures.AdaptiveRendering(scene, camera, integrator="path", samples=32, lights=lights).advance()
even = wrt.pictures.Rendering(scene, camera, integrator="path", samples=32, lights=lights).advance()
wrt.save_image("adaptive.png", picture.image())
wrt.save_image("even.png", even.image())
counts = picture.counts
wrt.save_image("samples.png", np.repeat((counts / counts.max())[..., None] ** 0.5, 3, axis=-1).astype(np.float32))
print(f"{counts.min()} to {counts.max()} samples a pixel, {counts.mean():.1f} in the mean; {picture.rays:,} rays")

if find_spec("pyoidn") is not None:
    import pyoidn

    layers = picture.layers
    calm = pyoidn.denoise(picture.linear, albedo=layers["albedo"], normal=layers["normal"], hdr=True)
    wrt.save_image("denoised.png", np.clip(calm, 0.0, 1.0) ** (1 / 2.2))

assert abs(counts.mean() / 32 - 1) < 0.1
