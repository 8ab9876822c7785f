"""Marks all tests of this folder as `studies`."""

from __future__ import annotations

from pathlib import Path

import pytest

FOLDER = Path(__file__).parent


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Adds the marker."""
    for item in items:
        if FOLDER in item.path.parents:
            item.add_marker("studies")
