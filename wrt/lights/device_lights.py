"""Tables of lights for kernels."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TypeAlias

import numpy as np
import warp as wp

from wrt.kernels.shading.emitters import light_table
from wrt.kernels.shading.emitters.environment import Environment
from wrt.lights.light_sources import AreaLight, DirectionalLight, PointLight, SpotLight
from wrt.lights.sky_image import Sky
from wrt.scene.scene import Scene

__all__ = ["Light", "Lights", "check_lights", "device_lights", "samples_sky"]

Light = PointLight | SpotLight | DirectionalLight | AreaLight | Sky

Lights: TypeAlias = "Light | Sequence[Light]"
"""As pictures take them."""

LUMINANCE = np.array([0.2126, 0.7152, 0.0722])

EVEN_SHARE = 0.25
"""Share of the choices of a light that do not depend on its power, for lights that are weak but near."""

EVEN_SKY_SHARE = 0.7
"""Share of the choices below which a path never chooses a sky of one colour: scattering samples such a sky as well as can be,
and the lights are then chosen more often (notebooks/records/2026-11-23-light-tiles.md)."""

BOX_ROOM = 1e-4
"""What a box is larger than what it holds on each side, in radii of the scene: many times the error of a hit."""

FLAT = {"rectangle": light_table.PARALLELOGRAM, "triangle": light_table.TRIANGLE, "sphere": light_table.SPHERE}


def check_lights(lights: Any) -> tuple[Light, ...]:
    """Lights as a tuple; one light stands for itself.

    Raises:
        TypeError: something else.
        ValueError: more than one sky.
    """
    listed = (lights,) if isinstance(lights, Light) else lights
    if not isinstance(listed, Sequence) or not all(isinstance(light, Light) for light in listed):
        raise TypeError(
            "lights must be a sequence of wrt.lights.PointLight, SpotLight, DirectionalLight, AreaLight and Sky, or one of "
            f"them, not {lights!r}"
        )
    if sum(isinstance(light, Sky) for light in listed) > 1:
        raise ValueError("lights has more than one wrt.lights.Sky; add their images instead")
    return tuple(listed)


def device_lights(scene: Scene, lights: Sequence[Light], emission: np.ndarray, of_face: np.ndarray) -> Any:
    """The table of lights on a scene's device.

    Args:
        scene: the scene.
        lights: what the caller gave.
        emission: (M, 3) radiance that materials emit.
        of_face: (F,) the material of each triangle, geometry shared by instances once.
    """
    device, center = scene.device, scene.center
    radius = 0.5 * float(np.linalg.norm(scene.bounds[1] - scene.bounds[0]))
    areas = [light for light in lights if isinstance(light, AreaLight)]
    others = [light for light in lights if not isinstance(light, AreaLight | Sky)]
    rows = [_area_row(light, center) for light in areas] + [_lamp_row(light, center, radius) for light in others]
    table = light_table.Lights()
    table.areas = len(areas)
    table.far = 4.0 * max(radius, 1e-30)
    table.triangle_entry, table.sky_entry = -1, -1
    triangles, powers, points = _emissive_triangles(scene, emission, of_face)
    if len(triangles):
        table.triangle_entry = len(rows)
        rows.append(_row(light_table.TRIANGLES, power=np.pi * powers.sum()))
        table.triangle_power = float(powers.sum())
        table.triangle = wp.array(triangles.astype(np.int32), dtype=int, device=device)
        room = BOX_ROOM * radius
        table.triangle_low = wp.vec3(*map(float, points.min(axis=0) - center - room))
        table.triangle_high = wp.vec3(*map(float, points.max(axis=0) - center + room))
        table.triangle_sums = wp.array(_sums(powers), dtype=float, device=device)
    sky = next((light for light in lights if isinstance(light, Sky)), None)
    if sky is not None:
        table.sky_entry = len(rows)
        rows.append(_row(light_table.SKY, power=np.pi * radius**2 * np.pi * float(sky.mean @ LUMINANCE)))
        table.sky = _environment(sky, device)
    table.count = len(rows)
    if rows:
        for name, dtype in (
            ("kind", int),
            ("position", wp.vec3),
            ("axis", wp.vec3),
            ("edge1", wp.vec3),
            ("edge2", wp.vec3),
            ("radiance", wp.vec3),
            ("shape", wp.vec4),
        ):
            values = np.array([row[name] for row in rows], dtype=np.int32 if dtype is int else np.float32)
            setattr(table, name, wp.array(values, dtype=dtype, device=device))
        weights = np.array([row["power"] for row in rows], dtype=np.float64)
        even = np.full(len(rows), 1.0 / len(rows))
        total = weights.sum()
        share = even if not total > 0.0 else EVEN_SHARE * even + (1.0 - EVEN_SHARE) * weights / total
        is_even_sky = sky is not None and sky.texels.shape[:2] == (1, 1)
        if is_even_sky and len(rows) > 1 and share[table.sky_entry] < EVEN_SKY_SHARE:
            share[table.sky_entry] = 0.0
        table.sums = wp.array(_sums(share), dtype=float, device=device)
    return table


def samples_sky(table: Any) -> bool:
    """Whether a path may choose the sky of a table on the CPU as its light."""
    if table.sky_entry < 0:
        return False
    low, high = table.sums.numpy()[table.sky_entry : table.sky_entry + 2]
    return bool(high > low)


def _row(kind: int, position: Any = 0.0, power: float = 0.0, **values: Any) -> dict[str, Any]:
    row: dict[str, Any] = {name: np.zeros(3) for name in ("axis", "edge1", "edge2", "radiance")}
    return row | {"kind": kind, "position": np.broadcast_to(position, 3), "shape": np.zeros(4), "power": power} | values


def _area_row(light: AreaLight, center: np.ndarray) -> dict[str, Any]:
    sides = 2.0 if light.two_sided else 1.0
    size = light.radius if light.shape == "sphere" else light.area
    return _row(
        FLAT[light.shape],
        light.position - center,
        sides * np.pi * light.area * float(np.dot(light.radiance, LUMINANCE)),
        axis=light.normal,
        edge1=light.edge1,
        edge2=light.edge2,
        radiance=light.radiance,
        shape=np.array([0.0, 0.0, size, float(light.two_sided)]),
    )


def _lamp_row(light: Any, center: np.ndarray, radius: float) -> dict[str, Any]:
    if isinstance(light, DirectionalLight):
        power = np.pi * radius**2 * float(np.dot(light.irradiance, LUMINANCE))
        return _row(light_table.DIRECTIONAL, 0.0, power, axis=light.direction, radiance=light.irradiance)
    strength = float(np.dot(light.intensity, LUMINANCE))
    if not isinstance(light, SpotLight):
        return _row(light_table.POINT, light.position - center, 4.0 * np.pi * strength, radiance=light.intensity)
    begin, end = np.cos(np.radians([light.inner, light.angle]))
    power = 2.0 * np.pi * (1.0 - 0.5 * (begin + end)) * strength
    shape = np.array([begin, end, 0.0, 0.0])
    return _row(light_table.SPOT, light.position - center, power, axis=light.direction, radiance=light.intensity, shape=shape)


def _emissive_triangles(scene: Scene, emission: np.ndarray, of_face: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Numbers of the scene's emissive triangles, area times luminance of each, and the corners of all whose material emits."""
    brightness = emission @ LUMINANCE
    if not brightness.any():
        return np.zeros(0, dtype=np.int64), np.zeros(0), np.zeros((0, 3))
    starts = np.cumsum([0] + [mesh.triangle_count for mesh in scene.meshes])
    if scene.instances:
        placed = list(zip(scene.geometry_ids, (instance.transform for instance in scene.instances), strict=True))
    else:
        placed = [(number, None) for number in range(len(scene.meshes))]
    numbers, powers, points, first = [], [], [], 0
    for geometry, transform in placed:
        mesh = scene.meshes[geometry]
        own = of_face[starts[geometry] : starts[geometry + 1]]
        bright = np.flatnonzero(brightness[own] > 0.0)
        corners = mesh.vertices[mesh.faces[bright]].astype(np.float64)
        if transform is not None:
            corners = corners @ transform[:3, :3].T + transform[:3, 3]
        points.append(corners.reshape(-1, 3))
        area = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
        numbers.append(first + bright)
        powers.append(area * brightness[own[bright]])
        first += mesh.triangle_count
    joined = np.concatenate(powers)
    used = joined > 0.0
    return np.concatenate(numbers)[used], joined[used], np.concatenate(points)


def _sums(weights: np.ndarray) -> np.ndarray:
    """(N + 1,) float32 cumulative shares from 0 to 1."""
    sums = np.concatenate([[0.0], np.cumsum(weights, dtype=np.float64)])
    return (sums / sums[-1]).astype(np.float32)


def _environment(sky: Sky, device: wp.Device) -> Environment:
    cells = sky.cells()
    rows, columns = cells.shape
    made = Environment()
    made.height, made.width = sky.texels.shape[:2]
    made.texels = wp.array(sky.texels.reshape(-1, 3), dtype=wp.vec3, device=device)
    made.east, made.north, made.up = (wp.vec3(*map(float, axis)) for axis in (sky.east, sky.north, sky.up))
    made.rows, made.columns = rows, columns
    made.row_sums = wp.array(_sums(cells.sum(axis=1)), dtype=float, device=device)
    made.cell_sums = wp.array(np.concatenate([_sums(row) for row in cells]), dtype=float, device=device)
    density = cells / (cells.mean() * 4.0 * np.pi)
    made.density = wp.array(density.reshape(-1).astype(np.float32), dtype=float, device=device)
    return made
