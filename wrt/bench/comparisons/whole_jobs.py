"""Whole jobs beside their rays: scans, images, tables, sun hours and a robot's step, and the same by today's tools.

Jobs around models, a print, a picture and environments, are in `wrt.bench.comparisons.model_jobs`.

A job is more than its rays: they are fired, and what they meet becomes ranges, points, labels, tables and files. The first
contender of a job traces the same rays and nothing else, so that ratios to it say what the rest costs.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from wrt import scenes, sensors
from wrt.bench.comparisons.model_jobs import (
    RAYS,
    Glass,
    Print,
    Worlds,
    picture_contenders,
    print_contenders,
    world_contenders,
)
from wrt.bench.core.paired_timing import Contender, Timing, take_turns
from wrt.meshes.instance import Instance
from wrt.meshes.mesh import TriangleMesh
from wrt.scene.scene import Scene

INSTANCES = 20


@dataclass(frozen=True)
class JobTimes:
    """What was measured of a job.

    Attributes:
        job: its name.
        rays: number of its rays.
        timings: of its contenders, the rays alone first.
        process: seconds of a fresh process that does it once; None if it was not timed.
    """

    job: str
    rays: int
    timings: dict[str, Timing]
    process: float | None

    def rows(self) -> list[dict[str, Any]]:
        """The figures as plain data: seconds, and ratios to the rays alone, round by round."""
        base = next(iter(self.timings.values()))
        found: list[dict[str, Any]] = []
        for name, timing in self.timings.items():
            row: dict[str, Any] = {"job": self.job, "contender": name, "rays": self.rays, "error": timing.error}
            if timing.error is None:
                row |= {"seconds": timing.median, "least": timing.spread[0], "ratio": timing.ratio_to(base)}
                row["least_ratio"] = timing.spread[0] / base.spread[0]
            found.append(row)
        return found


class Cell:
    """A robot's cell of 20 instances, a lidar and two cameras in it, and the rays of these.

    Args:
        size: 1 for 64 x 1024 beams and 640 x 480 pixels; rows and columns are in proportion.
        threads: of wrt and of peers; None for all cores.
    """

    def __init__(self, size: float, threads: int | None) -> None:
        box, pot = TriangleMesh(*_box()), scenes.build("teapot", level=8, ground=False)
        placed = [(box, _placed((20, 20, 0.2), (0, 0, -0.1)))]
        for x, y in ((10, 0), (-10, 0), (0, 10), (0, -10)):
            placed.append((box, _placed((0.2, 20, 4) if x else (20, 0.2, 4), (x, y, 2))))
        for number in range(INSTANCES - len(placed)):
            turn, far = 2.4 * number, 3.0 + 0.35 * number
            at = far * np.cos(turn), far * np.sin(turn), 0.0 if number % 3 else 0.5
            placed.append((pot, _placed((0.4, 0.4, 0.4), at)) if number % 3 else (box, _placed((1, 0.7, 1), at)))
        self.meshes = [(mesh, matrix) for mesh, matrix in placed]
        self.scene = Scene([Instance(mesh, matrix) for mesh, matrix in placed], device="cpu", num_threads=threads)
        self.threads, self.labels = threads or 0, np.arange(INSTANCES) % 5
        self.lidar = sensors.Lidar.preset("ouster_os1_64", columns=max(8, round(1024 * size)))
        width, height = max(8, round(640 * size)), max(6, round(480 * size))
        lens = sensors.BrownConrady(0.8 * width, 0.8 * width, (width - 1) / 2, (height - 1) / 2)
        self.camera = sensors.Camera(width, height, lens)
        self.lidar_pose = np.eye(4)
        self.lidar_pose[:3, 3] = 0.3, 0.2, 1.0
        self.views = [sensors.look_at([-3, -3, 2.0], [1, 1, 0.5]), sensors.look_at([3, -2, 1.5], [-1, 1, 0.5])]
        self.lidar_rays = self.lidar_pose[:3, 3].copy(), _turned(self.lidar.pattern.directions, self.lidar_pose)
        pixels = np.stack(np.meshgrid(np.arange(float(width)), np.arange(float(height))), axis=-1)
        axes = lens.unproject(pixels)[1]
        self.camera_rays = [(view[:3, 3].copy(), _turned(axes, view)) for view in self.views]

    def rays(self, name: str) -> int:
        """Number of rays of a job in the cell."""
        lidar, image = len(self.lidar.pattern), self.camera.width * self.camera.height
        return {"capture": image, "step": 2 * image + lidar}.get(name, lidar)

    def open3d(self) -> Callable[[tuple[np.ndarray, np.ndarray]], dict[str, np.ndarray]]:
        """What traces rays in Open3D's scene of the same meshes, and makes points of the hits.

        Raises:
            ImportError: Open3D is not installed.
        """
        from open3d import core
        from open3d.t.geometry import RaycastingScene

        other = RaycastingScene(nthreads=self.threads)
        for mesh, matrix in self.meshes:
            corners = mesh.vertices @ matrix[:3, :3].T + matrix[:3, 3]
            other.add_triangles(core.Tensor(corners.astype(np.float32)), core.Tensor(mesh.faces.astype(np.uint32)))  # type: ignore[call-overload]

        def trace(rays: tuple[np.ndarray, np.ndarray]) -> dict[str, np.ndarray]:
            origin, directions = rays
            both = np.concatenate([np.broadcast_to(origin.astype(np.float32), directions.shape), directions], axis=-1)
            found = other.cast_rays(core.Tensor(both), nthreads=self.threads)  # type: ignore[call-overload]
            t, ids = found["t_hit"].numpy(), found["geometry_ids"].numpy().astype(np.int32)
            return {"t": t, "id": ids, "point": origin + t[..., None] * directions}

        return trace


def scan_contenders(cell: Cell) -> list[Contender]:
    """A scan: its ranges, and points and labels beside them."""
    origin, directions = cell.lidar_rays
    ranges = "range", "intensity"
    points = *ranges, "position", "primitive_id", "instance_id"

    def scan(layers: tuple[str, ...]) -> list[Any]:
        return _read(cell.lidar.scan(cell.scene, cell.lidar_pose, labels=cell.labels, layers=layers), *layers)

    return [
        Contender(RAYS, lambda: cell.scene.intersect(origin, directions, 0.0, cell.lidar.max_range)),
        Contender("ranges and intensities", lambda: scan(ranges)),
        Contender("and points, ids", lambda: scan(points)),
        _of_open3d(cell, "Open3D, points by hand", lambda trace: trace(cell.lidar_rays)),
    ]


def capture_contenders(cell: Cell) -> list[Contender]:
    """An image of depths and labels."""
    layers = ("depth", "semantic_id")
    image = lambda: cell.camera.capture(cell.scene, cell.views[0], labels=cell.labels, layers=layers)  # noqa: E731
    return [
        Contender(RAYS, lambda: cell.scene.intersect(*cell.camera_rays[0])),
        Contender("depth and labels", lambda: _read(image(), *layers)),
        _of_open3d(cell, "Open3D", lambda trace: cell.labels[trace(cell.camera_rays[0])["id"] % INSTANCES]),
    ]


def table_contenders(cell: Cell) -> list[Contender]:
    """A table of a scan in the world, with labels."""
    origin, directions = cell.lidar_rays
    scan = cell.lidar.scan(cell.scene, cell.lidar_pose, labels=cell.labels)
    return [
        Contender(RAYS, lambda: cell.scene.intersect(origin, directions, 0.0, cell.lidar.max_range)),
        Contender(
            "scan and table",
            lambda: cell.lidar.scan(cell.scene, cell.lidar_pose, labels=cell.labels).to_structured("world"),
        ),
        Contender("table of a scan that was read", lambda: scan.to_structured("world")),
    ]


def step_contenders(cell: Cell) -> list[Contender]:
    """A robot's step: two cameras and a lidar at new poses, a table of each, and the lidar's in a new file.

    A file that replaces another one is waited for until it is on the disk (`wrt.atomic_files`)."""
    number, folder, files = [0], tempfile.TemporaryDirectory(), count()

    def moved(pose: np.ndarray) -> np.ndarray:
        number[0] += 1
        pose = pose.copy()
        pose[0, 3] += 1e-6 * number[0]
        return pose

    def path() -> Path:
        return Path(folder.name) / f"scan{next(files)}.ply"  # the folder lives as long as the contenders

    def rays() -> None:
        for origin, directions in cell.camera_rays:
            cell.scene.intersect(origin, directions)
        cell.scene.intersect(*cell.lidar_rays, 0.0, cell.lidar.max_range)

    def step(tables: bool) -> None:
        seen = "depth", "semantic_id"
        for view in cell.views:
            images = cell.camera.capture(cell.scene, moved(view), labels=cell.labels, layers=None if tables else seen)
            _ = images.to_structured() if tables else _read(images, *seen)
        scan = cell.lidar.scan(cell.scene, moved(cell.lidar_pose), labels=cell.labels, seed=number[0])
        sensors.write_points(path(), scan.to_structured("world"))

    def by_open3d(trace: Any) -> None:
        from open3d import core, t

        points = [trace(some)["point"] for some in (*cell.camera_rays, cell.lidar_rays)][-1]
        seen = points[np.isfinite(points).all(axis=-1)]
        t.io.write_point_cloud(path(), t.geometry.PointCloud(core.Tensor(np.float32(seen))))  # type: ignore[call-overload]

    return [
        Contender(RAYS, rays),
        Contender("images, table and file of the scan", lambda: step(False)),
        Contender("tables of pixels, too", lambda: step(True)),
        _of_open3d(cell, "Open3D, points by hand, file", by_open3d),
    ]


class Court:
    """A court, places on its floor, and suns of a day: hours of sun by sums over shadow rays.

    Args:
        size: 1 for 300 x 200 places and 100 suns, 6 M rays.
        threads: as in `Cell`.
    """

    def __init__(self, size: float, threads: int | None) -> None:
        self.mesh = scenes.build("atrium", detail=2)
        self.scene = Scene(self.mesh, device="cpu", num_threads=threads)
        low, high = self.mesh.bounds
        x, y = np.meshgrid(
            np.linspace(low[0], high[0], max(6, round(300 * size))), np.linspace(low[1], high[1], max(4, round(200 * size)))
        )
        above = np.stack([x, y, np.full_like(x, high[2] + 1.0)], axis=-1)
        floor = self.scene.intersect(above, [0.0, 0.0, -1.0])
        points = floor.position.reshape(-1, 3)
        self.points = points[np.isfinite(points).all(axis=1)] + [0.0, 0.0, 1e-3]
        self.floor = self.scene.intersect(above[floor.is_hit], [0.0, 0.0, -1.0])
        up = np.array([0.0, 0.0, 1.0], dtype=np.float32)
        self.spawned = np.asarray(self.floor.spawn(np.broadcast_to(up, self.floor.position.shape)))
        turn = np.linspace(-1.2, 1.2, max(4, round(100 * size)))
        suns = np.stack([np.sin(turn), 0.4 * np.ones_like(turn), np.cos(turn)], axis=-1)
        self.suns = (suns / np.linalg.norm(suns, axis=1, keepdims=True)).astype(np.float32)

    def rays(self, name: str) -> int:
        """Number of rays: from each place to each sun."""
        return len(self.points) * len(self.suns)


def sun_contenders(court: Court) -> list[Contender]:
    """Hours of sun: sums for each place, in memory, in a folder from which the job can be resumed, and by groups of weights.

    Rays of one sun are neighbours: they are parallel, and those of one place are not. They begin 1 mm above the floor. Those of
    `exposure` leave it, and pass the boxes of its triangles first, as do the "rays from the floor"."""
    from wrt.analysis import exposure
    from wrt.batches import WeightedSum
    from wrt.cluster import Job

    months = np.float64(np.arange(len(court.suns)) % 12 == np.arange(12)[:, None])

    def sums() -> Any:
        return court.scene.occluded_blocks(court.points, court.suns[:, None], reduce="sum", axis=0)

    def by_months() -> Any:
        reduce = WeightedSum(months)
        return court.scene.occluded_blocks(court.points, court.suns[:, None], reduce=reduce, axis=0)

    def in_folder() -> np.ndarray:
        with tempfile.TemporaryDirectory() as folder:
            return Job(Path(folder) / "job", by_months()).run().result()

    def by_trimesh() -> np.ndarray:
        shape = len(court.points), len(court.suns), 3
        origins = np.broadcast_to(court.points[:, None], shape).reshape(-1, 3)
        directions = np.broadcast_to(court.suns, shape).reshape(-1, 3)
        return embree().intersects_any(origins, directions).reshape(shape[:2]).sum(axis=1)

    made: list[Any] = []

    def embree() -> Any:
        if not made:
            import trimesh
            from trimesh.ray.ray_pyembree import RayMeshIntersector

            made.append(RayMeshIntersector(trimesh.Trimesh(court.mesh.vertices, court.mesh.faces, process=False)))
        return made[0]

    return [
        Contender(RAYS, lambda: court.scene.occluded(court.points, court.suns[:, None])),
        Contender("sums", lambda: sums().result()),
        Contender("sums of 12 months", lambda: by_months().result()),
        Contender("exposure of 12 months", lambda: exposure(court.scene, court.floor, court.suns, weights=months)),
        Contender("sums of 12 months in a folder", in_folder),
        Contender("rays from the floor alone", lambda: court.scene.occluded(court.spawned, court.suns[:, None])),
        Contender("trimesh + embreex", by_trimesh),
    ]


JOBS: dict[str, tuple[Callable[[float, int | None], Any], Callable[[Any], list[Contender]]]] = {
    "scan": (Cell, scan_contenders),
    "capture": (Cell, capture_contenders),
    "table": (Cell, table_contenders),
    "step": (Cell, step_contenders),
    "sun": (Court, sun_contenders),
    "print": (Print, print_contenders),
    "picture": (Glass, picture_contenders),
    "worlds": (Worlds, world_contenders),
}
"""Jobs by name: where they are, and who does them."""


def measure_jobs(
    names: Sequence[str], size: float, rounds: int, threads: int | None, process: bool, on_turn: Callable[[str], None]
) -> list[JobTimes]:
    """Times jobs, contenders in turn.

    Args:
        names: keys of `JOBS`.
        size: as in `Cell`, `Court`, `Print`, `Glass` and `Worlds`.
        rounds: in which contenders take turns.
        threads: as in `Cell`.
        process: whether to time fresh processes, too.
        on_turn: told what is under way.
    """
    found: list[JobTimes] = []
    places: dict[Any, Any] = {}

    def told(job: str) -> Callable[[str], None]:
        return lambda who: on_turn(f"{job}, {who}")

    for name in names:
        place, contenders = JOBS[name]
        if place not in places:
            places[place] = place(size, threads)
        made = places[place]
        timings = take_turns(contenders(made), rounds, on_turn=told(name))
        found.append(JobTimes(name, made.rays(name), timings, time_process(name, size) if process else None))
    return found


def run_alone(name: str, size: float) -> None:
    """Does a job once, as wrt does it: what a fresh process runs."""
    place, contenders = JOBS[name]
    contenders(place(size, None))[1].run()


def time_process(name: str, size: float) -> float:
    """Seconds of a fresh process that does a job once, kernels from the cache.

    Raises:
        RuntimeError: it fails.
    """
    code = f"from wrt.bench.comparisons.whole_jobs import run_alone; run_alone({name!r}, {size!r})"
    begin = perf_counter()
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(f"the process of the job {name!r} failed: {done.stderr[-500:]}")
    return perf_counter() - begin


def _of_open3d(cell: Cell, name: str, run: Callable[[Any], Any]) -> Contender:
    """A contender that needs Open3D, which its warm-up imports."""
    made: list[Any] = []

    def warm_up() -> Any:
        made.append(cell.open3d())
        return run(made[0])

    return Contender(name, lambda: run(made[0]), warm_up=warm_up)


def _read(found: Any, *names: str) -> list[Any]:
    return [getattr(found, name) for name in names]


def _box() -> tuple[np.ndarray, np.ndarray]:
    """A cube of edge 1 around the origin."""
    found = scenes.shapes.boxes([[-0.5] * 3], [[0.5] * 3])
    return found.vertices, found.faces


def _placed(scale: Sequence[float], at: Sequence[float]) -> np.ndarray:
    matrix = np.diag([*scale, 1.0])
    matrix[:3, 3] = at
    return matrix


def _turned(axes: np.ndarray, pose: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(axes @ pose[:3, :3].T, dtype=np.float32)
