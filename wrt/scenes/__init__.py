"""Built-in scenes, for use without a model file.

Every scene is a function with defaults that returns a `TriangleMesh` of any size. The same arguments, including the seed,
give the same triangles. z is up and the unit is a metre. `BUILTIN_SCENES` adds a camera and a light to each; `build` makes
a scene by name.

    mesh = wrt.scenes.build("wood", trees=100)
    view = wrt.scenes.BUILTIN_SCENES["wood"].camera      # dict(position=..., look_at=..., up=..., fov=...)
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

from wrt.meshes.mesh import TriangleMesh
from wrt.scenes.animations import Animation, Skin, walking_figure, waving_cloth
from wrt.scenes.colonnade import atrium
from wrt.scenes.cornell_box import cornell_box
from wrt.scenes.newell_teapot import teapot
from wrt.scenes.stadium import teapot_in_stadium
from wrt.scenes.trees import wood
from wrt.scenes.triangle_soup import random_triangles

__all__ = [
    "BUILTIN_SCENES",
    "Animation",
    "BuiltinScene",
    "Skin",
    "atrium",
    "build",
    "cornell_box",
    "random_triangles",
    "teapot",
    "teapot_in_stadium",
    "walking_figure",
    "waving_cloth",
    "wood",
]

Point = tuple[float, float, float]


@dataclass(frozen=True)
class BuiltinScene:
    """An entry of the table: how to build a scene, and a view of it.

    Attributes:
        name: key in `BUILTIN_SCENES`.
        description: one line for listings.
        function: builds the mesh from keyword options.
        position: position of the camera.
        look_at: the point at the image centre.
        fov: vertical field of view, in degrees.
        light: position of a point light.
        up: the camera's upward direction.
        options: default arguments of `function` in `build`.
    """

    name: str
    description: str
    function: Callable[..., TriangleMesh]
    position: Point
    look_at: Point
    fov: float
    light: Point
    up: Point = (0.0, 0.0, 1.0)
    options: Mapping[str, Any] = field(default_factory=lambda: MappingProxyType({}))

    @property
    def camera(self) -> dict[str, Any]:
        """The default view as keyword arguments: position, look_at, up, fov."""
        return {"position": self.position, "look_at": self.look_at, "up": self.up, "fov": self.fov}


_SCENES = (
    BuiltinScene(
        name="teapot",
        description="Newell's teapot on a ground plane",
        function=teapot,
        position=(4.6, -8.4, 5.0),
        look_at=(0.2, 0.0, 1.35),
        fov=32.0,
        light=(-4.0, -9.0, 12.0),
        options=MappingProxyType({"level": 16, "ground": True}),
    ),
    BuiltinScene(
        name="random_triangles",
        description="independent random triangles in the unit box",
        function=random_triangles,
        position=(2.1, -1.5, 1.5),
        look_at=(0.5, 0.5, 0.47),
        fov=29.0,
        light=(1.0, -3.0, 4.0),
        options=MappingProxyType({"count": 1000, "size": 0.1, "seed": 0}),
    ),
    BuiltinScene(
        name="teapot_in_stadium",
        description="a finely tessellated teapot in a coarse stadium a hundred times its size",
        function=teapot_in_stadium,
        position=(1.7, -3.6, 1.6),
        look_at=(-0.1, 0.0, 1.7),
        fov=58.0,
        light=(30.0, -60.0, 130.0),
        options=MappingProxyType({"level": 24, "rows": 24, "segments": 64}),
    ),
    BuiltinScene(
        name="atrium",
        description="a court with fluted columns, arcades and galleries, open to the sky",
        function=atrium,
        position=(-10.8, -4.6, 1.9),
        look_at=(2.0, 1.6, 3.6),
        fov=68.0,
        light=(-9.0, -13.0, 28.0),
        options=MappingProxyType({"bays": (6, 3), "storeys": 2, "detail": 4}),
    ),
    BuiltinScene(
        name="cornell_box",
        description="the Cornell box, with its materials and lamp",
        function=cornell_box,
        position=(0.0, -8.0, 2.73),
        look_at=(0.0, 2.8, 2.73),
        fov=39.3,
        light=(0.0, 2.8, 5.3),
        options=MappingProxyType({"blocks": True, "cells": 6}),
    ),
    BuiltinScene(
        name="wood",
        description="broad-leaved trees around a clearing, on uneven ground",
        function=wood,
        position=(3.0, -33.0, 5.0),
        look_at=(0.0, 0.0, 4.8),
        fov=40.0,
        light=(-30.0, -40.0, 50.0),
        options=MappingProxyType({"trees": 30, "leaves": 12, "seed": 0}),
    ),
)

BUILTIN_SCENES: dict[str, BuiltinScene] = {scene.name: scene for scene in _SCENES}


def build(name: str, **options: Any) -> TriangleMesh:
    """Builds a scene of `BUILTIN_SCENES`. Its `up` is that of the table: z.

    Args:
        name: key of the table.
        options: arguments of the scene's function; the others take the table's defaults.

    Raises:
        ValueError: unknown scene, or a bad value of an option.
        TypeError: the scene has no such option.
    """
    if name not in BUILTIN_SCENES:
        raise ValueError(f"unknown scene {name!r}; the built-in ones are {', '.join(sorted(BUILTIN_SCENES))}")
    scene = BUILTIN_SCENES[name]
    valid = list(inspect.signature(scene.function).parameters)
    unknown = [option for option in options if option not in valid]
    if unknown:
        raise TypeError(f"scene {name!r} has no option {unknown[0]!r}; its options are {', '.join(valid)}")
    mesh = scene.function(**{**scene.options, **options})
    mesh._up = mesh.up or scene.up
    return mesh
