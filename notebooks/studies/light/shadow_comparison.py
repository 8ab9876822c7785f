"""Shadow rays to one light: the light buffer and multi-frusta beside the engines of `occluded`, on the same rays."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from wrt.accelerators.tree_descriptions import Bvh
from wrt.bench.core.paired_timing import Contender, take_turns
from wrt.meshes.mesh import TriangleMesh
from wrt.scene.scene import Scene
from wrt.shadows.area_light_visibility import AreaLightVisibility
from wrt.shadows.light_buffer import LightBuffer

if TYPE_CHECKING:
    from wrt.imaging.cameras import PinholeCamera

ENGINES = ("packet", "stream", "single")
"""Traversals of `occluded` that are measured beside; the first is what ratios refer to."""

SAMPLES = (1, 4, 16, 64, 256)

T_MIN = 1e-3

MAX_RAYS = 1 << 21
"""Shadow rays of a comparison: points are thinned, in rows that stay neighbours."""

LIGHT_SIZE = 0.04
"""Edge of the area light as a fraction of the scene's longest extent."""


@dataclass(frozen=True)
class ShadowFigures:
    """What was measured of one engine.

    Attributes:
        light: "point", "point, shuffled", or "area, S samples".
        engine: "light_buffer", "multi_frusta" or a traversal of `occluded`.
        rays: number of shadow rays.
        occluded: share of them.
        megarays: millions of shadow rays a second, median.
        ratio: speed over that of the first of `ENGINES`, median of the rounds; None if that was not measured.
        same: whether the answers are those of the others.
        build: seconds to build the light buffer again; None for others.
        bytes: of the light buffer; None for others.
    """

    light: str
    engine: str
    rays: int
    occluded: float
    megarays: float
    ratio: float | None
    same: bool
    build: float | None = None
    bytes: int | None = None


def compare_shadows(
    mesh: TriangleMesh,
    camera: PinholeCamera,
    position: Sequence[float],
    *,
    samples: Sequence[int] = SAMPLES,
    resolution: int | None = None,
    rounds: int = 5,
    threads: int | None = None,
    on_turn: Callable[[str], None] = lambda name: None,
) -> list[ShadowFigures]:
    """Shadow rays from what a camera sees to a point light and to an area light around it.

    Args:
        mesh: casts the shadows.
        camera: shadow rays start at what its pixels see.
        position: of the light.
        samples: samples of the area light, one comparison each.
        resolution: of the light buffer; None for the default.
        rounds: number of rounds per engine.
        threads: on the CPU; None for all cores.
        on_turn: told the name of each turn.
    """
    scene = Scene(mesh, Bvh(), num_threads=threads)
    hits = scene.intersect(camera.rays())
    points = np.ascontiguousarray(hits.position[hits.is_hit].astype(np.float32))
    if not len(points):
        raise ValueError("the camera sees nothing of the model, so there are no shadow rays to measure")
    figures = compare_point_light(scene, points, position, resolution, rounds, on_turn)
    for count in samples:
        figures += compare_area_light(scene, points, position, count, rounds, on_turn)
    return figures


def compare_point_light(
    scene: Scene,
    points: np.ndarray,
    position: Sequence[float],
    resolution: int | None,
    rounds: int,
    on_turn: Callable[[str], None],
) -> list[ShadowFigures]:
    """The light buffer and the engines of `occluded`, on points in the order of the picture and in random order."""
    buffer = LightBuffer(scene, position, resolution)
    built = take_turns([Contender("build", buffer.update)], rounds, on_turn=on_turn)["build"].median
    figures = []
    shuffled = points[np.random.default_rng(0).permutation(len(points))]
    for light, places in (("point", points), ("point, shuffled", shuffled)):
        rays = buffer.shadow_rays(places, T_MIN)
        own = Contender("light_buffer", lambda places=places: buffer.occluded(places, T_MIN), len(places))
        rows = compare(scene, light, own, rays, rounds, on_turn)
        figures += [ShadowFigures(**row, build=built, bytes=buffer.bytes) for row in rows[:1]]
        figures += [ShadowFigures(**row) for row in rows[1:]]
    return figures


def compare_area_light(
    scene: Scene, points: np.ndarray, position: Sequence[float], samples: int, rounds: int, on_turn: Callable[[str], None]
) -> list[ShadowFigures]:
    """Multi-frusta and the engines of `occluded`, which find their rays in memory."""
    edge = LIGHT_SIZE * float((scene.bounds[1] - scene.bounds[0]).max())
    corner = np.asarray(position, dtype=np.float64) - [edge / 2, edge / 2, 0.0]
    light = AreaLightVisibility.rectangle(scene, corner, (edge, 0, 0), (0, edge, 0), samples)
    most = max(MAX_RAYS // samples, 1)
    begin = max(len(points) - most, 0) // 2
    places = points[begin : begin + most]
    rays = light.shadow_rays(places, T_MIN)
    own = Contender("multi_frusta", lambda: light.occluded(places, T_MIN), len(rays))
    rows = compare(scene, f"area, {samples} samples", own, rays, rounds, on_turn)
    return [ShadowFigures(**row) for row in rows]


def compare(
    scene: Scene, light: str, own: Contender, rays: Any, rounds: int, on_turn: Callable[[str], None]
) -> list[dict[str, Any]]:
    """Times a contender beside the engines of `occluded` for the same rays."""
    origins, directions = np.ascontiguousarray(rays.origins), np.ascontiguousarray(rays.directions)

    def by(traversal: str) -> Callable[[], Any]:
        return lambda: scene.occluded(origins, directions, T_MIN, 1.0, traversal=traversal)

    contenders = [own, *(Contender(name, by(name), len(rays)) for name in ENGINES)]
    timings = take_turns(contenders, rounds, settle=0.5, on_turn=lambda name: on_turn(f"{light}: {name}"))
    expected = timings[ENGINES[0]].result
    rows = []
    for name, timing in timings.items():
        slower = timing.ratio_to(timings[ENGINES[0]])
        rows.append(
            {
                "light": light,
                "engine": name,
                "rays": len(rays),
                "occluded": float(expected.mean()),
                "megarays": len(rays) / timing.median / 1e6,
                "ratio": None if slower is None else 1.0 / slower,
                "same": bool(np.array_equal(timing.result, expected)),
            }
        )
    return rows
