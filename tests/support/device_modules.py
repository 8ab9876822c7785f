"""All modules with device code."""

from __future__ import annotations

import importlib
from pathlib import Path
from types import ModuleType

ROOT = Path(__file__).resolve().parents[2]


def device_modules() -> list[ModuleType]:
    """All modules of kernels/ and builders/, imported."""
    names = []
    for room in ("kernels", "builders"):
        for path in sorted((ROOT / room).rglob("*.py")):
            parts = path.relative_to(ROOT).with_suffix("").parts
            names.append(".".join(("wrt", *(part for part in parts if part != "__init__"))))
    return [importlib.import_module(name) for name in names]
