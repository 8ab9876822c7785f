"""Makes the reference picture of the Cornell box with Mitsuba 3, which `tests/imaging/test_cornell_box.py` compares with.

Two steps, because Mitsuba need not be installed beside wrt:

    python tests/support/cornell_reference.py export FOLDER       # with wrt: the box as one PLY file a material
    python tests/support/cornell_reference.py trace FOLDER        # with mitsuba: FOLDER/cornell_reference.npy, kept beside the
    test python tests/support/cornell_reference.py speed FOLDER        # with mitsuba: paths a second

The reference has 64 x 64 pixels, a box filter, and paths of at most 6 rays; 2^14 samples a pixel, in float32.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np

SIZE, DEPTH, SAMPLES = 64, 6, 1 << 14


def export(folder: Path) -> None:
    """Writes the triangles of each material to a file."""
    import wrt

    mesh = wrt.scenes.build("cornell_box", cells=1)
    of_face = mesh.materials.numbers(mesh.triangle_count)
    for number in range(len(mesh.materials.materials)):
        corners = mesh.vertices[mesh.faces[of_face == number]].reshape(-1, 3)
        wrt.TriangleMesh(corners.astype(np.float32), np.arange(len(corners)).reshape(-1, 3)).save(folder / f"{number}.ply")
    colors = np.array([[*one.color, *one.emission] for one in mesh.materials.materials])
    view = wrt.scenes.BUILTIN_SCENES["cornell_box"]
    np.savez(folder / "cornell.npz", colors=colors, origin=view.position, target=view.look_at, fov=view.fov)


def mitsuba_scene(folder: Path, size: int, samples: int):
    """The same scene for Mitsuba."""
    import mitsuba as mi

    known = np.load(folder / "cornell.npz")
    camera = mi.ScalarTransform4f().look_at(known["origin"].tolist(), known["target"].tolist(), [0, 0, 1])
    scene = {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": DEPTH, "rr_depth": 5},
        "sensor": {
            "type": "perspective",
            "fov": float(known["fov"]),
            "to_world": camera,
            "film": {
                "type": "hdrfilm",
                "width": size,
                "height": size,
                "rfilter": {"type": "box"},
                "pixel_format": "rgb",
                "component_format": "float32",
            },
            "sampler": {"type": "independent", "sample_count": samples},
        },
    }
    for number, row in enumerate(known["colors"]):
        shape = {
            "type": "ply",
            "filename": str(folder / f"{number}.ply"),
            "face_normals": True,
            "bsdf": {
                "type": "twosided",
                "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": row[:3].tolist()}},
            },
        }
        if row[3:].any():
            shape["emitter"] = {"type": "area", "radiance": {"type": "rgb", "value": row[3:].tolist()}}
        scene[f"part{number}"] = shape
    return mi.load_dict(scene)


def trace(folder: Path) -> None:
    """Renders the reference: the mean of pictures with different seeds."""
    import mitsuba as mi

    mi.set_variant("scalar_rgb")
    batch = 1 << 12
    scene = mitsuba_scene(folder, SIZE, batch)
    total = np.zeros((SIZE, SIZE, 3))
    for seed in range(SAMPLES // batch):
        total += np.array(mi.render(scene, seed=seed, spp=batch))
        print(seed, total.mean(axis=(0, 1)) / (seed + 1), flush=True)
    np.save(folder / "cornell_reference.npy", (total * batch / SAMPLES).astype(np.float32))


def speed(folder: Path, size: int = 256, samples: int = 64) -> None:
    """Prints paths a second."""
    import mitsuba as mi

    mi.set_variant("scalar_rgb")
    scene = mitsuba_scene(folder, size, samples)
    times = []
    for seed in range(3):
        start = time.perf_counter()
        np.array(mi.render(scene, seed=seed, spp=samples))
        times.append(time.perf_counter() - start)
    print(f"Mitsuba {mi.__version__} scalar_rgb: {size * size * samples / np.median(times) / 1e6:.3f} million paths/s")


if __name__ == "__main__":
    {"export": export, "trace": trace, "speed": speed}[sys.argv[1]](Path(sys.argv[2]))
