"""Measures path tracing beside Mitsuba 3, in turns in one process: paths a second, and the brightness of both pictures.

    python tests/support/mitsuba_speed.py cornell,atrium,bunny=MODEL.ply [scalar_rgb,llvm_ad_rgb] [ROUNDS] [ROULETTE]

Mitsuba must be importable; "llvm_ad_rgb" needs a libLLVM that works (DRJIT_LIBLLVM_PATH names it; 19 does, 16 does not). All
pictures have 256 x 256 pixels and paths of at most 6 rays, the Cornell box 64 samples a pixel, the others 16. The atrium has a
sky of one colour and a sun, the bunny of clear glass a sky and a round lamp. The first round of each is not counted.

Mitsuba has Embree build its tree with high quality, so trees of many triangles are built with reinsertion here. ROULETTE is
"default": Russian roulette decides about the fifth ray of a path and later ones, in Mitsuba about the sixth; "same": about the
fifth in both; or "none". Only with "none" do both follow paths through glass equally far, since Mitsuba's roulette leaves out
how refraction changes radiance.
"""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

import wrt
from wrt.scenes.shapes import plane

SIZE, DEPTH = 256, 6

GREY = wrt.Material(color=0.8)

TREES = dict.fromkeys(("atrium", "bunny"), wrt.Bvh(reinsertion=3))
"""Trees of scenes that are not built with the default one."""

RR_DEPTH = {"default": 5, "same": 4, "none": 1000}
"""Mitsuba's `rr_depth` by kind of roulette."""


def cornell(_model: str) -> tuple[Any, ...]:
    view = wrt.scenes.BUILTIN_SCENES["cornell_box"]
    return [wrt.scenes.build("cornell_box", cells=1)], wrt.PinholeCamera(SIZE, SIZE, **view.camera), None, 64


def atrium(_model: str) -> tuple[Any, ...]:
    view = wrt.scenes.BUILTIN_SCENES["atrium"]
    lights = {"sky": 1.0, "sun": ((0.4, 0.3, -1.0), 3.0)}
    mesh = wrt.scenes.build("atrium").with_materials(GREY)
    return [mesh], wrt.PinholeCamera(SIZE, SIZE, **view.camera), lights, 16


def bunny(model: str) -> tuple[Any, ...]:
    mesh = wrt.TriangleMesh.load(model)
    low, high = mesh.bounds
    ground = plane(low[:2] - 4 * mesh.extent, high[:2] + 4 * mesh.extent, z=low[2])
    center = np.asarray(mesh.center) + np.array((0, -2, 2)) * mesh.extent
    lamp = (center, 0.3 * mesh.extent, 60.0)
    glass = wrt.Material("dielectric", index=1.5, color=1.0)
    meshes = [mesh.with_materials(glass), ground.with_materials(wrt.Material(color=0.6))]
    return meshes, wrt.PinholeCamera.framing(mesh, SIZE, SIZE, up=(0, 0, 1)), {"sky": 1.0, "lamp": lamp}, 16


def own(meshes: Any, camera: Any, lights: Any, samples: int, tree: Any = "auto", roulette: bool = True):
    """A function that makes our picture."""
    made = None
    if lights is not None:
        made = [wrt.lights.Sky(lights["sky"])]
        made += [wrt.lights.DirectionalLight(*lights["sun"])] if "sun" in lights else []
        made += [wrt.lights.AreaLight.sphere(*lights["lamp"])] if "lamp" in lights else []
    scene = wrt.Scene(meshes, tree)
    options = {"lights": made, "integrator": "path", "samples": samples, "depth": DEPTH, "smooth": False, "roulette": roulette}
    return lambda seed: wrt.pictures.Rendering(scene, camera, seed=seed, **options).advance().linear


def peer(variant: str, folder: Path, meshes: Any, camera: Any, lights: Any, samples: int, rr_depth: int = 5):
    """A function that makes Mitsuba's."""
    import mitsuba as mi

    mi.set_variant(variant)
    place = mi.ScalarTransform4f().look_at(list(camera.position), list(camera.look_at), list(camera.up))
    film = {"type": "hdrfilm", "width": SIZE, "height": SIZE, "rfilter": {"type": "box"}, "pixel_format": "rgb"}
    scene: dict[str, Any] = {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": DEPTH, "rr_depth": rr_depth},
        "sensor": {
            "type": "perspective",
            "fov": float(camera.fov),
            "fov_axis": "y",
            "to_world": place,
            "film": film,
            "sampler": {"type": "independent", "sample_count": samples},
        },
    }
    if lights is not None:
        scene["sky"] = {"type": "constant", "radiance": {"type": "rgb", "value": lights["sky"]}}
        if "sun" in lights:
            toward, strength = lights["sun"]
            scene["sun"] = {"type": "directional", "direction": list(toward), "irradiance": {"type": "rgb", "value": strength}}
        if "lamp" in lights:
            center, radius, radiance = lights["lamp"]
            emitter = {"type": "area", "radiance": {"type": "rgb", "value": radiance}}
            scene["lamp"] = {"type": "sphere", "center": list(map(float, center)), "radius": float(radius), "emitter": emitter}
    for number, mesh in enumerate(meshes):
        of_face = mesh.materials.numbers(mesh.triangle_count)
        for k, material in enumerate(mesh.materials.materials):
            path = folder / f"{variant}-{number}-{k}.ply"
            wrt.TriangleMesh(mesh.vertices, mesh.faces[of_face == k]).save(path)
            color = {"type": "rgb", "value": list(map(float, material.color))}
            matte = {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": color}}
            glass = {"type": "dielectric", "int_ior": material.index, "ext_ior": 1.0}
            shape = {"type": "ply", "filename": str(path), "face_normals": True}
            shape["bsdf"] = glass if material.kind == "dielectric" else matte
            if np.any(material.emission):
                emitted = {"type": "rgb", "value": list(map(float, material.emission))}
                shape["emitter"] = {"type": "area", "radiance": emitted}
            scene[f"part{number}_{k}"] = shape
    loaded = mi.load_dict(scene)

    def render(seed: int) -> np.ndarray:
        mi.set_variant(variant)
        return np.array(mi.render(loaded, seed=seed, spp=samples))

    return render


def main(names: str, variants: str = "scalar_rgb", rounds: int = 3, roulette: str = "default") -> None:
    """Prints a line a scene and contender."""
    for given in names.split(","):
        name, _, model = given.partition("=")
        case = {"cornell": cornell, "atrium": atrium, "bunny": bunny}[name](model)
        with tempfile.TemporaryDirectory() as folder:
            runs = {"wrt": own(*case, TREES.get(name, "auto"), roulette != "none")}
            for variant in variants.split(","):
                runs[variant] = peer(variant, Path(folder), *case, RR_DEPTH[roulette])
            times: dict[str, list[float]] = {contender: [] for contender in runs}
            mean = {}
            for seed in range(rounds + 1):
                for contender, run in runs.items():
                    start = time.perf_counter()
                    mean[contender] = run(seed).mean()
                    times[contender].append(time.perf_counter() - start)
            for contender, taken in times.items():
                speed = SIZE * SIZE * case[3] / np.median(taken[1:]) / 1e6
                print(f"{name:8s} {contender:12s} {speed:6.3f} million paths/s, brightness {mean[contender]:.5f}", flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:3], *map(int, sys.argv[3:4]), *sys.argv[4:5])
