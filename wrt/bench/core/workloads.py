"""The rays of a mesh that the benchmark traces.

    far, near   closest hit   pinhole views that see all of the mesh, or fly into it: coherent rays from one origin
    random      closest hit   origins anywhere in the bounding box, directions anywhere: nothing coherent
    shadow      occlusion     from the surface points that `far` sees to a point light
    ao          occlusion     ambient occlusion: from the same points, cosine-distributed about the normal, to a quarter
                              of the box's diagonal
    all_far, all_random       all hits of the rays of `far` and `random`
    inside       inside test  points anywhere in the bounding box

Views have `size` x `size` pixels, `random` and `inside` have `size` squared rays or points, `shadow` and `ao` one ray for
each pixel of `far` that hits.
All arrays are float32 and made once; the same arguments give the same rays. Shared origins are a view of one point.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from wrt.engine.rays.rays import Rays
from wrt.meshes.mesh import TriangleMesh
from wrt.scene.scene import Scene
from wrt.tables import lookup, one_of

CLOSEST = "closest"
OCCLUSION = "occlusion"
ALL = "all"
INSIDE = "inside"

FIELD_OF_VIEW = 45.0
"""Of the views, in degrees, both ways."""

DISTANCE = {"far": 1.1, "near": 0.55}
"""Distance from the centre of the box to the eye; at 1 the box's sphere spans the view as seen from its centre."""

TOWARDS = (0.3, 0.25, 1.0)
"""Direction from the centre of the box to the eye."""

LIGHT = (-1.0, 2.0, 0.7)
"""From the centre of the box to the light, in radii of the box's sphere."""

OFFSET = 1e-4
"""How far secondary rays start off the surface, as a share of the box's diagonal, so that they do not hit it at once."""

AO_RANGE = 0.25
"""Length of ambient occlusion rays, as a share of the box's diagonal."""

TILE = 4
"""Edge of the pixel tiles in which views are ordered."""

ORDERS = ("tiles", "rows")


@dataclass(frozen=True)
class Workload:
    """Rays to ask of a mesh.

    Attributes:
        name: key in `WORKLOADS`.
        query: "closest", "occlusion", "all" or "inside".
        origins, directions: (N, 3) float32; all origins are a view of one point if the rays share it. "inside" asks about
            the origins, by whatever rays.
        t_max: where all rays end, in units of their directions.
        shares_origin: whether all rays start at one point.
    """

    name: str
    query: str
    origins: np.ndarray
    directions: np.ndarray
    t_max: float = float("inf")
    shares_origin: bool = False

    def __len__(self) -> int:
        """Number of rays."""
        return len(self.directions)

    @property
    def rays(self) -> Rays:
        """The same as wrt takes them."""
        return Rays(self.origins, self.directions, 0.0, self.t_max)

    def thinned(self, count: int) -> Workload:
        """At most `count` rays, evenly picked; itself if it has no more."""
        chosen = self.chosen(count)
        if len(chosen) == len(self):
            return self
        origins = self.origins[: len(chosen)] if self.shares_origin else self.origins[chosen]
        return replace(self, origins=origins, directions=self.directions[chosen])

    def chosen(self, count: int) -> np.ndarray:
        """Indices of the rays that `thinned(count)` keeps."""
        kept = min(count, len(self))
        return np.arange(kept) * len(self) // max(kept, 1)


class WorkloadMaker:
    """Makes the workloads of one mesh.

    Args:
        mesh: what the rays are shot at.
        size: views have size x size pixels, `random` has size * size rays.
        order: of a view's pixels, "tiles" (4 x 4 pixels, tile after tile; needs a multiple of 4) or "rows".
        seed: of the random rays.

    Raises:
        ValueError: unknown order, or a size that is not positive or does not divide into tiles.
    """

    def __init__(self, mesh: TriangleMesh, *, size: int = 1024, order: str = "tiles", seed: int = 0) -> None:
        one_of(ORDERS, order, "order")
        if size < 1 or (order == "tiles" and size % TILE):
            raise ValueError(f"size is {size}; it must be a positive multiple of {TILE}, or any positive number by rows")
        self.mesh, self.size, self.order, self.seed = mesh, size, order, seed

    def make(self, names: Sequence[str]) -> Iterator[Workload]:
        """The workloads of these names, one after the other."""
        for name in names:
            yield lookup(WORKLOADS, name, "workload")(self, name)

    def view(self, name: str) -> Workload:
        """A pinhole view."""
        low, high = self.mesh.bounds
        slope = np.tan(np.radians(FIELD_OF_VIEW / 2.0))
        forward = -np.array(TOWARDS) / np.linalg.norm(TOWARDS)
        right = np.cross(forward, [0.0, 1.0, 0.0])
        right /= np.linalg.norm(right)
        up = np.cross(right, forward)
        eye = (low + high) / 2.0 - forward * DISTANCE[name] * self.mesh.extent / 2.0 / slope
        across = ((np.arange(self.size) + 0.5) / self.size * 2.0 - 1.0) * slope
        directions = forward + across[None, :, None] * right - across[:, None, None] * up
        directions = normalized(directions).reshape(-1, 3)[pixel_order(self.size, self.order)]
        origins = np.broadcast_to(eye.astype(np.float32), directions.shape)
        return Workload(name, CLOSEST, origins, directions.astype(np.float32), shares_origin=True)

    def random(self, name: str) -> Workload:
        """Rays from anywhere to anywhere."""
        generator = np.random.default_rng(self.seed)
        origins = generator.uniform(*self.mesh.bounds, (self.size * self.size, 3))  # type: ignore[call-overload]
        directions = normalized(generator.normal(size=origins.shape))
        return Workload(name, CLOSEST, origins.astype(np.float32), directions.astype(np.float32))

    def all_hits(self, name: str) -> Workload:
        """All hits of the rays of another workload."""
        source = name.removeprefix("all_")
        return replace(WORKLOADS[source](self, source), name=name, query=ALL)

    def inside(self, name: str) -> Workload:
        """Points in the box: the origins of `random`."""
        return replace(self.random(name), query=INSIDE)

    @property
    def light(self) -> np.ndarray:
        """(3,) float64, the point light of `shadow`."""
        return self.mesh.center + np.array(LIGHT) * self.mesh.extent / 2.0

    def shadow(self, name: str) -> Workload:
        """Rays to the light; their directions reach it at t = 1."""
        points, _ = self.visible
        return Workload(name, OCCLUSION, points, (self.light - points).astype(np.float32), t_max=1.0)

    def ambient(self, name: str) -> Workload:
        """Cosine-distributed rays above the surface: a point of the unit sphere about the normal's end."""
        points, normals = self.visible
        directions = normals + normalized(np.random.default_rng(self.seed).normal(size=points.shape))
        directions = normalized(np.where(np.linalg.norm(directions, axis=1, keepdims=True) > 1e-3, directions, normals))
        return Workload(name, OCCLUSION, points, directions.astype(np.float32), t_max=AO_RANGE * self.mesh.extent)

    @cached_property
    def visible(self) -> tuple[np.ndarray, np.ndarray]:
        """(K, 3) float32 points just above the surface that `far` sees and (K, 3) float64 normals towards the eye."""
        view = self.view("far")
        hits = Scene(self.mesh, device="cpu").intersect(view.rays)
        seen = np.flatnonzero(hits.is_hit & np.any(hits.normal, axis=-1))
        normals = hits.normal[seen].astype(np.float64)
        normals *= np.where(np.sum(normals * view.directions[seen], axis=1, keepdims=True) > 0.0, -1.0, 1.0)
        points = hits.position[seen] + normals * OFFSET * self.mesh.extent
        return points.astype(np.float32), normals


WORKLOADS: dict[str, Callable[[WorkloadMaker, str], Workload]] = {
    "far": WorkloadMaker.view,
    "near": WorkloadMaker.view,
    "random": WorkloadMaker.random,
    "shadow": WorkloadMaker.shadow,
    "ao": WorkloadMaker.ambient,
    "all_far": WorkloadMaker.all_hits,
    "all_random": WorkloadMaker.all_hits,
    "inside": WorkloadMaker.inside,
}


def normalized(vectors: np.ndarray) -> np.ndarray:
    """(..., 3) vectors of length one."""
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def pixel_order(size: int, order: str) -> np.ndarray:
    """(size * size,) row-major pixel indices in the order in which a view lists its rays."""
    pixels = np.arange(size * size)
    if order == "rows":
        return pixels
    return pixels.reshape(size // TILE, TILE, size // TILE, TILE).transpose(0, 2, 1, 3).ravel()
