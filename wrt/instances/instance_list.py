"""The instances of a scene as objects, as arrays, or both: what is not there is made when something reads it.

A simulation moves thousands of instances at each step and reads none of them: making their objects would be a good part of such
a step. Of a robot's scene a few of some dozen move, for which objects are the faster form.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cached_property
from typing import Any, overload

import numpy as np

from wrt.meshes.instance import Instance

MAX_OBJECTS = 32
"""Instances that change up to which making objects is faster than copying arrays of all instances."""


class InstanceList(Sequence[Instance]):
    """Instances, in the order of their ids; those that have not changed stay the same objects.

    Args:
        known: them, or what they were before some of them changed.
        changed: (N,) bool: which of `known` are out of date; None for none.
        transforms: (N, 4, 4) float64, read-only, of all instances; None for those of `known`.
        masks, environments: (N,) int64 of all instances; None for those of `known`.
    """

    def __init__(
        self,
        known: tuple[Instance, ...],
        changed: np.ndarray | None = None,
        transforms: np.ndarray | None = None,
        masks: np.ndarray | None = None,
        environments: np.ndarray | None = None,
    ) -> None:
        self._known, self._changed = known, changed
        given = {"transforms": transforms, "masks": masks, "environments": environments}
        self.__dict__.update((name, values) for name, values in given.items() if values is not None)
        if changed is None:
            self.__dict__["objects"] = known

    @cached_property
    def objects(self) -> tuple[Instance, ...]:
        """The instances."""
        made, rows = list(self._known), np.flatnonzero(self._changed).tolist()
        transforms, masks, environments = self.transforms, self.masks.tolist(), self.environments.tolist()
        for row in rows:
            made[row] = made[row].moved(transforms[row], masks[row], environments[row])
        return tuple(made)

    @cached_property
    def transforms(self) -> np.ndarray:
        """(N, 4, 4) float64, read-only."""
        values = np.array([one.transform for one in self._known])
        values.flags.writeable = False
        return values

    @cached_property
    def masks(self) -> np.ndarray:
        """(N,) int64."""
        return np.array([one.mask for one in self._known], dtype=np.int64)

    @cached_property
    def environments(self) -> np.ndarray:
        """(N,) int64."""
        return np.array([one.environment for one in self._known], dtype=np.int64)

    def some(self, rows: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
        """(M, 4, 4) transforms and (M,) masks of some instances; of all for None."""
        if rows is None:
            return self.transforms, self.masks
        if "objects" not in self.__dict__ or len(rows) > MAX_OBJECTS:
            return self.transforms[rows], self.masks[rows]
        own = [self.objects[row] for row in rows.tolist()]
        return np.array([one.transform for one in own]), np.array([one.mask for one in own])

    def moved(
        self, rows: np.ndarray | None, transforms: np.ndarray | None, mask: int | None, environment: int | None
    ) -> InstanceList:
        """The instances after some of them have changed.

        Args:
            rows: (M,) their numbers, the last of equal ones counts; None for all.
            transforms: (M, 4, 4) float64, read-only; None for those they have.
            mask, environment: of all of them; None for those they have.
        """
        if rows is not None and len(rows) <= MAX_OBJECTS and "objects" in self.__dict__:
            made = list(self.objects)
            for place, row in enumerate(rows.tolist()):
                old = made[row]
                made[row] = old.moved(
                    old.transform if transforms is None else transforms[place],
                    old.mask if mask is None else mask,
                    old.environment if environment is None else environment,
                )
            return InstanceList(tuple(made))
        known, changed = self.latest()
        changed[slice(None) if rows is None else rows] = True
        fields = (self.transforms, transforms), (self.masks, mask), (self.environments, environment)
        return InstanceList(known, changed, *(replaced(old, rows, new) for old, new in fields))

    @property
    def made(self) -> tuple[Instance, ...]:
        """The objects that were made last, some of which may be out of date."""
        return self.__dict__.get("objects", self._known)

    def latest(self) -> tuple[tuple[Instance, ...], np.ndarray]:
        """The objects that were made last, and (N,) bool, to be written to: which of them are out of date."""
        if "objects" in self.__dict__:
            return self.objects, np.zeros(len(self), dtype=bool)
        return self._known, self._changed.copy()

    def detached(self) -> InstanceList:
        """The same instances, all on the host."""
        made = InstanceList(self._known, self._changed, self.transforms, self.masks, self.environments)
        if "objects" in self.__dict__:
            made.__dict__["objects"] = self.objects
        return made

    def __len__(self) -> int:
        return len(self._known)

    @overload
    def __getitem__(self, index: int) -> Instance: ...
    @overload
    def __getitem__(self, index: slice) -> tuple[Instance, ...]: ...
    def __getitem__(self, index: Any) -> Any:
        return self.objects[index]

    def __iter__(self) -> Iterator[Instance]:
        return iter(self.objects)


def replaced(values: np.ndarray, rows: np.ndarray | None, others: Any) -> np.ndarray:
    """Values with others in some rows, or in all for None, read-only; the values themselves without others."""
    if others is None:
        return values
    if rows is None and isinstance(others, np.ndarray):
        return others
    values = values.copy()
    values[slice(None) if rows is None else rows] = others
    values.flags.writeable = False
    return values
