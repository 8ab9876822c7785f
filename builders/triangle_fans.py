"""Triangle fans of a mesh (Galin and Akkouche 2005).

**Problem.** Neighbouring triangles share vertices, but a test of a ray and a single triangle cannot use that. A fan is a centre
and a rim. Its triangles are the centre with two consecutive rim vertices. What is computed for a ray and a rim vertex serves
two triangles (`wrt.kernels.traversal.fan_brute_force`).

**Idea.** A greedy algorithm divides a mesh into fans. Taken as a centre, vertex c takes all its remaining triangles, chain by
chain. Its fitness is 2 v + 7 r - 11 t, where v is the number of its remaining triangles, r the number of their open edges,
which keeps the algorithm near its border, and t the number of single-triangle fans that would result.

**Data.** Lists of vertices and triangles, on the host (`TriangleFans`). Triangles are neighbours if they share two vertex
indices. An edge with more than two triangles joins the first two.

**Start of a closed mesh.** As published, the first fan of a mesh without open edges is that of a given vertex (`start`), and
every later centre is a vertex of a triangle at the border that this opens, or next to one. Without `start`, every vertex is a
candidate, and the weight of r favours the border where one exists.

**Departures.** t counts the single triangles that c would leave behind without a neighbour, and also those that it
would take one by one although they have neighbours. Otherwise an ear of the mesh would be cut off at its tip.

**Complexity.** A candidate is evaluated when a triangle at it, or next to one at it, is removed: O(F) evaluations for meshes of
bounded valence, O(log F) each for the queue.

**Limits.** The code runs on the host (notebooks/records/2026-11-21-triangle-tests.md has times and sizes of fans).

References: galin-akkouche-2005.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from heapq import heapify, heappop, heappush

import numpy as np

CONNECTED, OPEN, SINGLE = 2, 7, 11
"""Weights of v, r and t in the fitness, as published."""


@dataclass(frozen=True)
class TriangleFans:
    """All triangles of a mesh, each in one fan.

    Attributes:
        centre: (N,) int32 vertex of each fan.
        first: (N + 1,) int32 index of each fan's first rim vertex in `rim`.
        rim: (F + N,) int32 vertices. A fan of M triangles has M + 1; if it is closed, the first is repeated at the end.
        primitive: (F,) int32 triangles in the order of their fans. Those of fan f begin at `first[f] - f`.
        corner: (F,) int32, for each of these triangles, the position (0, 1, 2) of the centre among its vertices, plus 3 if the
            rim runs against their order.
    """

    centre: np.ndarray
    first: np.ndarray
    rim: np.ndarray
    primitive: np.ndarray
    corner: np.ndarray

    def __len__(self) -> int:
        """Number of fans."""
        return len(self.centre)

    @property
    def sizes(self) -> np.ndarray:
        """(N,) triangles of each fan."""
        return np.diff(self.first) - 1


class _FanBuilder:
    """The remaining triangles and their adjacency."""

    def __init__(self, faces: np.ndarray) -> None:
        self.faces = [tuple(face) for face in faces.tolist()]
        self.at: dict[int, dict[int, None]] = defaultdict(dict)
        by_edge: dict[tuple[int, int], list[int]] = defaultdict(list)
        for number, face in enumerate(self.faces):
            for k in range(3):
                self.at[face[k]][number] = None
                by_edge[tuple(sorted((face[k], face[k - 1])))].append(number)
        self.across: list[dict[int, None]] = [{} for _ in self.faces]
        for triangles in by_edge.values():
            for one, other in zip(triangles[::2], triangles[1::2], strict=False):
                if one != other:
                    self.across[one][other] = self.across[other][one] = None

    def chains(self, centre: int) -> list[list[int]]:
        """The remaining triangles of a vertex as chains of neighbours. A single chain may be closed."""
        left, rows = dict(self.at[centre]), []
        while left:
            ends = [n for n in left if sum(m in left for m in self.across[n]) < 2]
            row = [ends[0] if ends else next(iter(left))]
            while row:
                left.pop(row[-1])
                following = next((n for n in self.across[row[-1]] if n in left and self.follows(row, n, centre)), None)
                if following is None:
                    break
                row.append(following)
            rows.append(row)
        return rows

    def follows(self, row: list[int], number: int, centre: int) -> bool:
        """Whether a triangle continues a chain at an edge to the centre that the chain has not passed."""
        spoke = set(self.faces[row[-1]]) & set(self.faces[number]) - {centre}
        return len(spoke) == 1 and (len(row) == 1 or not spoke <= set(self.faces[row[-2]]))

    def fitness(self, centre: int) -> int:
        """The fitness 2 v + 7 r - 11 t."""
        star = self.at[centre]
        border = [n for n in star if len(self.across[n]) < 3]
        open_edges = sum(3 - len(self.across[n]) for n in border)
        around = {m for n in star for m in self.across[n] if m not in star}
        single = sum(all(n in star for n in self.across[m]) for m in around)
        single += sum(len(row) == 1 for row in self.chains(centre)) if border else 0
        return CONNECTED * len(star) + OPEN * open_edges - SINGLE * single

    def take(self, centre: int) -> list[list[int]]:
        """Removes all triangles of a vertex and returns them as chains."""
        rows = self.chains(centre)
        for number in [n for row in rows for n in row]:
            for vertex in self.faces[number]:
                self.at[vertex].pop(number, None)
            for other in self.across[number]:
                self.across[other].pop(number, None)
        return rows

    def near(self, rows: list[list[int]]) -> set[int]:
        """Vertices whose fitness may have changed: those of the chains, and those of all triangles that remain at them."""
        rim = {vertex for row in rows for number in row for vertex in self.faces[number]}
        return rim | {vertex for v in rim for number in self.at[v] for vertex in self.faces[number]}


def build_fans(faces: np.ndarray, start: int | None = None) -> TriangleFans:
    """Divides a mesh into fans.

    Args:
        faces: (F, 3) integer vertex indices, F >= 1. Vertices are the same if their indices are equal.
        start: vertex of the first fan; those of later fans are then near the border. None: any vertex may be next.

    Raises:
        ValueError: no triangle has the vertex `start`.
    """
    faces = np.asarray(faces)
    proper = (faces != np.roll(faces, 1, axis=1)).all(axis=1)
    fan_builder = _FanBuilder(faces[proper])
    number = np.flatnonzero(proper)
    fitness = {vertex: fan_builder.fitness(vertex) for vertex in fan_builder.at}
    if start is not None and start not in fitness:
        raise ValueError(f"start is {start}, which is a vertex of no triangle")
    rest = [(-value, vertex) for vertex, value in fitness.items()]
    queue = rest if start is None else [(-fitness[start], start)]
    heapify(queue)
    fans = [(int(faces[n, 0]), [int(v) for v in faces[n, 1:]], [int(n)]) for n in np.flatnonzero(~proper)]
    near_border = None if start is None else set()
    while queue or near_border is not None:
        if not queue:  # another part of the mesh, which the border has not reached
            near_border = None
            queue = [(-value, vertex) for vertex, value in fitness.items() if value is not None]
            heapify(queue)
            continue
        value, centre = heappop(queue)
        if -value != fitness.get(centre) or not fan_builder.at[centre]:
            continue
        rows = fan_builder.take(centre)
        fans += [(centre, rim_of(centre, [fan_builder.faces[n] for n in row]), number[row].tolist()) for row in rows]
        for vertex in fan_builder.near(rows):
            changed = fan_builder.fitness(vertex) if fan_builder.at[vertex] else None
            is_new = near_border is not None and vertex not in near_border
            if changed is not None and (is_new or changed != fitness[vertex]):
                heappush(queue, (-changed, vertex))
            fitness[vertex] = changed
            if near_border is not None:
                near_border.add(vertex)
    return pack(faces, fans)


def rim_of(centre: int, row: list[tuple[int, int, int]]) -> list[int]:
    """Rim vertices of a chain of triangles around a centre."""
    place = row[0].index(centre)
    rim = [row[0][place - 2], row[0][place - 1]]
    if len(row) > 1 and rim[1] not in row[1]:
        rim.reverse()
    for face in row[1:]:
        rim.append(next(v for v in face if v not in (centre, rim[-1])))
    return rim


def pack(faces: np.ndarray, fans: list[tuple[int, list[int], list[int]]]) -> TriangleFans:
    """The lists of fans as arrays."""
    corner = []
    for centre, rim, triangles in fans:
        for k, number in enumerate(triangles):
            face = faces[number].tolist()
            place = face.index(centre)
            corner.append(place + (0 if face[place - 2] == rim[k] else 3))
    return TriangleFans(
        centre=np.array([centre for centre, _, _ in fans], dtype=np.int32),
        first=np.cumsum([0] + [len(rim) for _, rim, _ in fans]).astype(np.int32),
        rim=np.array([vertex for _, rim, _ in fans for vertex in rim], dtype=np.int32),
        primitive=np.array([number for _, _, triangles in fans for number in triangles], dtype=np.int32),
        corner=np.array(corner, dtype=np.int32),
    )
