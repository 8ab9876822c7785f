"""The README: its Python runs as written, its marked commands are there for continuous integration, its links hold."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from PIL import Image

import wrt
from wrt.cli import main

ROOT = Path(__file__).resolve().parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")


def test_python_example(tmp_path, monkeypatch):
    """Ten lines that work on any model."""
    (code,) = re.findall(r"```python\n(.*?)```", README, flags=re.DOTALL)
    assert len(code.splitlines()) <= 12
    wrt.scenes.build("teapot", level=6, ground=False).save(tmp_path / "model.ply")
    monkeypatch.chdir(tmp_path)
    names: dict = {"__name__": "readme"}
    exec(compile(code, "README.md", "exec"), names)
    assert names["hits"].is_hit.mean() > 0.3
    assert names["lit"].shape == (1_000_000,)
    assert 0.1 < names["lit"].mean() < 0.9
    assert Image.open("model.png").size == (640, 480)


@pytest.mark.parametrize("mark", ["picture", "tests"])
def test_marked_commands(mark):
    """Each is one line that installs what it needs and runs."""
    assert re.search(rf"<!-- {mark} -->\n```sh\npip install -e [^\n]+ && [^\n]+\n```", README)


def test_commands_are_there():
    (sentence,) = re.findall(r"the commands ([^;.]+?) on \[another\]", README, flags=re.DOTALL)
    assert sorted(re.findall(r"`(?:wrt )?(\w+)`", sentence)) == sorted(main.list_commands(None))


def test_links_lead_somewhere():
    targets = re.findall(r"\]\((?!https?:)([^)#]+)\)", README)
    assert len(targets) > 20
    for target in targets:
        assert (ROOT / target).exists(), target


def test_it_is_short():
    assert len(README.splitlines()) <= 100


def test_pictures_are_shown_and_lead_somewhere():
    pictures = re.findall(r'<a href="([^"]+)"><img src="([^"]+)" alt="([^"]+)"', README)
    assert len(pictures) == 4
    for link, target, text in pictures:
        assert (ROOT / link).is_file()
        assert text
        picture = Image.open(ROOT / target).convert("RGB")
        assert min(picture.size) >= 200
        assert (ROOT / target).stat().st_size < 250_000
        assert len(picture.resize((64, 64)).getcolors(64 * 64)) > 100
