"""Materials of OBJ files: the diffuse colour and its image. Highlights, transparency and other images are not read.

References: wavefront-technologies-1995.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from wrt.materials.material import Material
from wrt.materials.trimesh_materials import to_linear
from wrt.meshes.files.file_images import FileImages
from wrt.meshes.files.mesh_source import MeshSource
from wrt.meshes.files.text_lines import plain_text

__all__ = ["UvMap", "read_materials_of"]

GREY = (0.8, 0.8, 0.8)
"""The colour of a material that states none, sRGB."""

VALUES = {"blendu": 1, "blendv": 1, "boost": 1, "mm": 2, "texres": 1, "clamp": 1, "bm": 1, "imfchan": 1, "type": 1, "cc": 1}
"""Options of images, and how many words follow each."""


@dataclass(frozen=True)
class UvMap:
    """Texture coordinates of an image: scaled, then moved."""

    scale: tuple[float, float] = (1.0, 1.0)
    offset: tuple[float, float] = (0.0, 0.0)

    def __call__(self, uv: np.ndarray) -> np.ndarray:
        with np.errstate(over="ignore", invalid="ignore"):
            return (uv * np.array(self.scale, np.float32) + np.array(self.offset, np.float32)).astype(np.float32)


@dataclass(frozen=True)
class Entry:
    """A material as a library has it."""

    color: tuple[float, ...] = GREY
    image: str | None = None
    clamps: bool = False
    map: UvMap = UvMap()


def read_materials_of(
    names: list[str], libraries: list[str], has_uv: bool, source: MeshSource
) -> dict[str, tuple[Material, UvMap]]:
    """Materials by name, and how each maps texture coordinates. What is missing is a warning, and plain.

    Args:
        names: those that the mesh uses.
        libraries: the words behind "mtllib", one string a line.
        has_uv: whether the mesh has texture coordinates; without, images are not read.
        source: of the mesh.
    """
    entries: dict[str, Entry] = {}
    for name in dict.fromkeys(libraries):
        for text in _library(name, source):
            entries = _entries(text, source) | entries
    images, found = FileImages(source), {}
    for name in names:
        entry = entries.get(name)
        if entry is None:
            where = ", ".join(f"'{one}'" for one in libraries) or "no material library, since there is no line 'mtllib'"
            source.warn(f"the material '{name}' is not in {where}; its surfaces are plain")
            entry = Entry()
        texture = None
        if entry.image is not None and has_uv:
            wrap = ("clamp", "clamp") if entry.clamps else ("repeat", "repeat")
            texture = images.of_file(entry.image, f"material '{name}'", wrap)
        elif entry.image is not None:
            source.warn(
                f"the material '{name}' has an image, and the mesh has no texture coordinates to place it; it is left out"
            )
        color = np.ones(3) if texture is not None else to_linear(np.clip(entry.color, 0.0, 1.0))
        found[name] = Material(color=color, color_texture=texture), UvMap() if texture is None else entry.map
    return found


def _library(name: str, source: MeshSource) -> list[bytes]:
    """The text of a library; of several, if the name is none of a file but its words are."""
    try:
        return [source.referenced(name, "a material library")]
    except FileNotFoundError:
        words = name.split()
    texts = []
    for word in words:
        try:
            texts.append(source.referenced(word, "a material library"))
        except FileNotFoundError:
            source.warn(f"there is no file '{word}', a material library; its materials are plain")
    return texts


def _entries(data: bytes, source: MeshSource) -> dict[str, Entry]:
    found: dict[str, Entry] = {}
    name = None
    for line in plain_text(data).decode("utf-8", "replace").split("\n"):
        word, _, rest = line.strip().partition(" ")
        rest = rest.strip()
        if word == "newmtl":
            name = rest
            found.setdefault(name, Entry())
        elif name is not None and word == "Kd":
            found[name] = replace(found[name], color=_color(rest, name, source))
        elif name is not None and word.lower() == "map_kd":
            found[name] = _with_image(found[name], rest, name, source)
    return found


def _color(text: str, name: str, source: MeshSource) -> tuple[float, ...]:
    words = text.split()[:3]
    try:
        color = tuple(float(word) for word in words)
    except ValueError:
        color = ()
    if len(color) == 1:
        color *= 3
    if len(color) != 3 or not np.isfinite(color).all():
        source.warn(f"the colour of the material '{name}' is '{text[:40]}', not three finite numbers; its surfaces are plain")
        return GREY
    return color


def _with_image(entry: Entry, text: str, name: str, source: MeshSource) -> Entry:
    """Takes the options before the name of the image, which may have blanks."""
    words, clamps, at = text.split(), False, UvMap()
    while words and words[0].startswith("-") and words[0][1:] in (*VALUES, "s", "o", "t"):
        option = words.pop(0)[1:]
        if option in VALUES:
            given, words = words[: VALUES[option]], words[VALUES[option] :]
            clamps |= option == "clamp" and given == ["on"]
            continue
        numbers = []
        while len(words) > 1 and len(numbers) < 3 and _is_number(words[0]):
            numbers.append(float(words.pop(0)))
        if option == "t":
            continue
        pair = tuple((numbers + ([0.0, 0.0] if option == "o" else [1.0, 1.0])[len(numbers) :])[:2])
        if not np.isfinite(pair).all():
            source.warn(f"the image of the material '{name}' has an option -{option} that is not finite; it is ignored")
            continue
        at = replace(at, **{"scale" if option == "s" else "offset": pair})  # type: ignore[arg-type]
    return replace(entry, image=" ".join(words) or None, clamps=clamps, map=at)


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True
