"""The README: its Python runs as written, its tables are complete, its marked commands are there for continuous integration."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import wrt
from wrt.builders.bvh import BVH_BUILDERS
from wrt.builders.kdtree import KDTREE_BUILDERS
from wrt.kernels.traversal import TRAVERSALS
from wrt.kernels.traversal.mailbox import MAILBOXES
from wrt.kernels.traversal.packet import CULLINGS
from wrt.kernels.triangle import TRIANGLE_TESTS

ROOT = Path(__file__).resolve().parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")


def test_python_examples(tmp_path, monkeypatch):
    """Ten lines that work on any model, and what goes on from there."""
    first, *more = re.findall(r"```python\n(.*?)```", README, flags=re.DOTALL)
    assert len(first.splitlines()) <= 12
    wrt.scenes.build("teapot", level=6, ground=False).save(tmp_path / "model.ply")
    monkeypatch.chdir(tmp_path)
    names: dict = {"__name__": "readme"}
    for number, code in enumerate((first, *more)):
        path = tmp_path / f"example_{number}.py"  # Warp reads the source of kernels
        path.write_text(code, encoding="utf-8")
        exec(compile(code, str(path), "exec"), names)
    assert names["hits"].is_hit.mean() > 0.3
    assert names["dark"].shape == (1_000_000,)
    assert (names["number"] == names["lists"].count).all()
    assert names["three"].count.max() <= 3 < names["number"].max()
    assert 0.01 < names["inside"].mean() < 0.9
    assert names["matrix"].shape == (len(names["points"]),) * 2
    assert names["matrix"].diagonal().all()
    assert set(names["met"].instance_id) >= {-1, 0, 1, 100}
    assert names["shade"].mean() < names["forest"].occluded(names["origins"], names["directions"]).mean() < 1
    assert set(names["index_ray"]) == set(np.flatnonzero(names["number"][:1000]))
    np.testing.assert_array_equal(names["answer"]["t_hit"], names["hits"].t)
    seen = names["scene"].intersect(names["camera"].rays()).is_hit
    assert (names["picture"][~seen] == 0).all()
    assert 0.3 < names["picture"][seen].mean() < 0.95
    row = names["scene"].intersect(names["eye"].numpy(), names["fan"].numpy()).t
    np.testing.assert_array_equal(names["depth"].numpy(), row)
    np.testing.assert_allclose(names["guess"].numpy()[0], names["camera"].position, atol=1e-3 * names["mesh"].extent)
    np.testing.assert_allclose(names["exact"].t, names["hits"].t[:1000], rtol=1e-3)
    assert Image.open("model.png").size == (640, 480)


@pytest.mark.parametrize("name", [*BVH_BUILDERS, *KDTREE_BUILDERS, *TRAVERSALS, *CULLINGS, *MAILBOXES, *TRIANGLE_TESTS])
def test_every_algorithm_is_listed(name):
    assert f"`{name}`" in README


@pytest.mark.parametrize("mark", ["install", "main", "tests"])
def test_marked_commands(mark):
    assert re.search(rf"<!-- {mark} -->\n```sh\n.+?\n```", README, flags=re.DOTALL)


def test_links_lead_somewhere():
    for target in re.findall(r"\]\((?!https?:)([^)#]+)\)", README):
        assert (ROOT / target).exists(), target
