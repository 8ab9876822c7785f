"""Files of points as MODEL: which files are such, their points, and the colours of these."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from wrt.cli.arguments import busy, check_file

if TYPE_CHECKING:
    import numpy as np

    from wrt.clouds.point_cloud import PointCloud

SUFFIXES = (".pcd", ".las", ".laz", ".bin", ".xyz")
"""Of files that never hold triangles."""

DARK, BRIGHT = 2.0, 98.0
"""Percentiles of intensities that are shown as the darkest and the brightest grey."""

DARKEST, BRIGHTEST = 0.15, 0.95
"""Those greys, as displayed."""


@dataclass
class CloudModel:
    """The points of a file.

    Attributes:
        path: of the file.
        points: (N, 3) float64, finite; at least one.
        left_out: how many had a coordinate that is NaN or infinite.
        fields: names of what the file has of each point.
        colors: (N, 3) in [0, 1], as displayed; None if the file has neither colours nor intensities.
        radius: of the points, positive.
        spacing: `wrt.clouds.spacing`.
    """

    path: Path
    points: np.ndarray
    left_out: int
    fields: tuple[str, ...]
    colors: np.ndarray | None
    radius: float
    spacing: float

    @property
    def name(self) -> str:
        """For messages."""
        return self.path.name

    @property
    def albedo(self) -> Any:
        """(N, 3) linear, or a number."""
        import numpy as np

        if self.colors is None:
            return 0.8
        return np.where(self.colors <= 0.04045, self.colors / 12.92, ((self.colors + 0.055) / 1.055) ** 2.4)

    def build(self, given: Mapping[str, Any]) -> PointCloud:
        """The cloud, on the requested device."""
        from wrt.clouds.point_cloud import PointCloud

        with busy("building the tree"):
            return PointCloud(self.points, self.radius, device=given["device"], num_threads=given["threads"])

    def summary(self) -> dict[str, Any]:
        """Figures for `wrt info`."""
        low, high = self.points.min(axis=0), self.points.max(axis=0)
        figures: dict[str, Any] = {"name": self.name, "points": len(self.points), "points left out": self.left_out}
        figures |= {"fields": ", ".join(self.fields), "low": low.tolist(), "high": high.tolist()}
        return figures | {"spacing": self.spacing, "radius": self.radius}


def is_cloud(path: Path | None) -> bool:
    """Whether a file holds points and no triangles, by its suffix, or by the header of a PLY file."""
    if path is None or not path.is_file():
        return False
    suffix = path.suffix.lower()
    return _has_no_faces(path) if suffix == ".ply" else suffix in SUFFIXES


def refuse_cloud(path: Path | None, command: str) -> None:
    """Refuses files of points.

    Raises:
        click.UsageError: it is one.
    """
    if is_cloud(path):
        raise click.UsageError(
            f"'{path}' holds points, and `wrt {command}` needs triangles; `wrt render` and `wrt info` take it"
        )


def load_cloud(path: Path, given: Mapping[str, Any]) -> CloudModel:
    """The points of a file.

    Args:
        path: of a file for which `is_cloud` is true.
        given: the options of the command; "radius" may be among them.

    Raises:
        click.UsageError: no point, or no radius can be found; an accelerator other than a BVH.
        ValueError, ImportError: as `wrt.sensors.read_points`.
    """
    import numpy as np

    from wrt.clouds.spacing import spacing

    check_file(path)
    if given["accelerator"] not in ("auto", "bvh"):
        raise click.UsageError(f"--accelerator {given['accelerator']} is for triangles; points are in a BVH")
    with busy(f"reading {path}"):
        places, values, fields = _read_text(path) if path.suffix.lower() == ".xyz" else _read_table(path)
    good = np.isfinite(places).all(axis=1)
    if not good.any():
        raise click.UsageError(f"'{path}' has {len(places)} points, and none with finite coordinates")
    points = places[good]
    with busy("looking for neighbours"):
        found = spacing(points, given["device"], given["threads"])
    radius = given.get("radius") or found
    if not radius > 0.0:
        raise click.UsageError(f"all points of '{path}' are at the same place; give their --radius")
    colors = None if values is None else np.asarray(values[good], dtype=np.float64)
    return CloudModel(path, points, int((~good).sum()), fields, colors, radius, found)


Read = tuple["np.ndarray", "np.ndarray | None", tuple[str, ...]]


def _read_text(path: Path) -> Read:
    """Coordinates, colours and fields of what trimesh reads."""
    import numpy as np
    import trimesh

    from wrt.meshes.files.mesh_source import read_regular_file

    read_regular_file(path, "a file of points")
    try:
        loaded: Any = trimesh.load(path, process=False)
        places = np.asarray(loaded.vertices, dtype=np.float64).reshape(-1, 3)
        given = np.asarray(getattr(loaded, "colors", ()))
    except Exception as error:  # loaders raise errors of any kind
        raise ValueError(f"cannot read '{path}': {type(error).__name__}: {error}") from None
    if given.ndim == 2 and len(given) == len(places) > 0 and given.shape[1] >= 3:
        return places, _as_shares(given[:, :3]), ("x", "y", "z", "red", "green", "blue")
    return places, None, ("x", "y", "z")


def _read_table(path: Path) -> Read:
    """Coordinates, colours and fields of `wrt.sensors.read_points`."""
    import numpy as np

    from wrt.sensors.files.point_reading import read_points

    table = read_points(path)
    places = np.stack([table[axis].astype(np.float64) for axis in "xyz"], axis=-1)
    names = {str(name).lower(): str(name) for name in table.dtype.names or ()}
    colors = next((read(table, names) for wanted, read in COLORS if all(name in names for name in wanted)), None)
    return places, colors, tuple(table.dtype.names or ())


def _channels(table: np.ndarray, names: Mapping[str, str]) -> np.ndarray:
    import numpy as np

    return _as_shares(np.stack([table[names[name]] for name in ("red", "green", "blue")], axis=-1))


def _packed(key: str) -> Callable[[np.ndarray, Mapping[str, str]], np.ndarray]:
    """Colours of the Point Cloud Library: the bits of a float or an integer, 0x00RRGGBB."""

    def read(table: np.ndarray, names: Mapping[str, str]) -> np.ndarray:
        import numpy as np

        values = table[names[key]]
        bits = np.ascontiguousarray(values, np.float32).view(np.uint32) if values.dtype.kind == "f" else values
        return np.stack([bits.astype(np.int64) >> shift & 255 for shift in (16, 8, 0)], axis=-1) / 255.0

    return read


def _intensities(table: np.ndarray, names: Mapping[str, str]) -> np.ndarray:
    import numpy as np

    values = np.nan_to_num(table[names["intensity"]].astype(np.float64), posinf=0.0, neginf=0.0)
    low, high = np.percentile(values, (DARK, BRIGHT)) if len(values) else (0.0, 0.0)
    share = np.clip((values - low) / (high - low), 0.0, 1.0) if high > low else np.full(len(values), 0.7)
    return np.repeat((DARKEST + (BRIGHTEST - DARKEST) * share)[:, None], 3, axis=1)


COLORS: tuple[tuple[tuple[str, ...], Callable[[Any, Mapping[str, str]], Any]], ...] = (
    (("red", "green", "blue"), _channels),
    (("rgb",), _packed("rgb")),
    (("rgba",), _packed("rgba")),
    (("intensity",), _intensities),
)
"""Fields that give colours, and what reads them; the first that a file has."""


def _as_shares(values: np.ndarray) -> np.ndarray:
    """Colours in [0, 1]: of integers, the share of 255, or of 65535 if one is above 255."""
    import numpy as np

    numbers = np.nan_to_num(values.astype(np.float64))
    full = 1.0 if values.dtype.kind == "f" and numbers.max(initial=0.0) <= 1.0 else 255.0
    return np.clip(numbers / (65535.0 if numbers.max(initial=0.0) > 255.0 else full), 0.0, 1.0)


def _has_no_faces(path: Path) -> bool:
    """Whether the header of a PLY file announces points, and neither faces nor strips of triangles."""
    from wrt.meshes.files.ply_rows import MAX_HEADER, read_header

    with path.open("rb") as file:
        start = file.read(MAX_HEADER)
    try:
        header = read_header(start)
    except ValueError:  # loaders say what is wrong with it
        return False
    rows = {element.name: element.count for element in header.elements}
    return rows.get("vertex", 0) > 0 and not rows.get("face") and not rows.get("tristrips")
