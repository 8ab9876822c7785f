"""Cases: what is put to the test, as plain data, so that a failure can be kept in a small file and run again."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

CORPUS = Path(__file__).parent / "corpus"
"""Cases that once failed, and some of each kind that never did: the tests replay them."""


@dataclass(frozen=True)
class Case:
    """One try.

    Attributes:
        what: "meshes", "rays", "files" or "loaders".
        options: plain values.
        arrays: by name.
    """

    what: str
    options: dict[str, Any]
    arrays: dict[str, np.ndarray] = field(default_factory=dict)

    def save(self, path: Path) -> None:
        """Writes an .npz file."""
        path.parent.mkdir(parents=True, exist_ok=True)
        header = json.dumps({"what": self.what, "options": self.options})
        np.savez_compressed(path, case=np.array(header), **self.arrays)

    @classmethod
    def load(cls, path: Path) -> Case:
        """Reads what `save` wrote."""
        with np.load(path, allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
        return cls(**json.loads(str(arrays.pop("case"))), arrays=arrays)


class WrongAnswer(Exception):
    """What ran to its end and is not right."""
