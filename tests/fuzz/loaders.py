"""Readers of mesh files in memory, thousands of files a second: glTF, OBJ with materials, PLY, STL, OFF, and their images.

What is mutated are the valid files of `tests/support` (`hostile_files`, `hostile_gltf`) and some with materials and images.
Bytes and numbers are changed as in `files`; the JSON of glTF is also changed as a tree: values, keys and members of lists are
replaced, removed or repeated. A file is refused with a ValueError that says why, or what was read is a mesh: finite points,
valid indices, materials that fit the triangles. Reading takes no file system: what a file refers to is in the case.
"""

from __future__ import annotations

import base64
import io
import json
import sys
import tempfile
import warnings
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

import wrt
from wrt.meshes.files.mesh_reading import parse_mesh
from wrt.meshes.files.mesh_source import FileMesh, MeshSource

from .cases import Case, WrongAnswer
from .files import MUTATIONS

TESTS = Path(__file__).resolve().parents[1]

VALUES: tuple[Any, ...] = (
    0, 1, -1, 2, 3, 4, 5, 6, 7, 255, 65535, 1 << 31, 1 << 40, 1 << 63, 0.5, -0.5, 1e39, 1e308, float("nan"), float("inf"),
    True, False, None, "", "x", "VEC3", "SCALAR", "MAT4", "data:,", "data:;base64,AAAA", "../a", "http://a", [], [0], [0, 1, 2],
    [[0]], {}, {"extensions": {}}, [1.0] * 16, 5120, 5121, 5123, 5125, 5126, 33071, 33648, 10497,
)  # fmt: skip
"""In place of a value in JSON."""


@dataclass
class MemorySource(MeshSource):
    """A source whose references are in memory."""

    files: dict[str, bytes] = field(default_factory=dict)

    def referenced(self, name: str, what: str) -> bytes:
        """A file of the case."""
        if name not in self.files:
            raise FileNotFoundError(f"there is no file '{name}' ({what})")
        return self.files[name]


@cache
def seeds() -> dict[str, list[dict[str, bytes]]]:
    """Valid files by extension: each with what it refers to; the first one is the mesh."""
    sys.path.insert(0, str(TESTS))
    try:
        from support.hostile_files import FILES
        from support.hostile_gltf import GLTF_FILES
    finally:
        sys.path.remove(str(TESTS))
    found: dict[str, list[dict[str, bytes]]] = {}
    for file in [*FILES, *GLTF_FILES]:
        if file.name.startswith("chain_of"):
            continue
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / file.name
            file.write(path)
            others = {one.name: one.read_bytes() for one in Path(folder).iterdir() if one != path}
            found.setdefault(path.suffix[1:], []).append({file.name: path.read_bytes(), **others})
    for name, files in with_looks().items():
        found.setdefault(name.rpartition(".")[2], []).extend([files] * 4)
    return found


def with_looks() -> dict[str, dict[str, bytes]]:
    """Files with materials, colours and images."""
    from PIL import Image

    out = io.BytesIO()
    Image.fromarray(np.arange(48, dtype=np.uint8).reshape(4, 4, 3)).save(out, "PNG")
    png = out.getvalue()
    square = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)]
    obj = "mtllib a.mtl\n" + "".join("v {} {} {} 0.5 0.5 1\n".format(*point) for point in square)
    obj += "vt 0 0\nvt 1 0\nvt 1 1\nusemtl red\nf 1/1 2/2 3/3 4/1\nusemtl blue\nf 1//1 2/2/1 -1/-1\n"
    mtl = b"newmtl red\nKd 1 0 0\nmap_Kd -clamp on -s 2 2 1 -o 0.5 a.png\nnewmtl blue\nKd 0 0 1\nillum 2\n"
    names = ["x", "y", "z", "s", "t", "red", "green", "blue"]
    ply = "ply\nformat ascii 1.0\ncomment TextureFile a.png\nelement vertex 4\n"
    ply += "".join(f"property {'uchar' if name in names[5:] else 'float'} {name}\n" for name in names)
    ply += "element face 1\nproperty list uchar int vertex_indices\nend_header\n"
    ply += "".join("{} {} {} 0.5 1 255 0 9\n".format(*point) for point in square) + "4 0 1 2 3\n"
    off = "STCOFF\n4 1 0\n" + "".join("{} {} {} 9 8 7 255 0.5 1\n".format(*point) for point in square) + "4 0 1 2 3 1 0 0\n"
    points, uv = np.array(square, "<f4").tobytes(), np.array([(0, 0), (2, 0), (2, 2), (0, 2)], "<f4").tobytes()
    data = points + uv + bytes([0, 1, 2, 0, 2, 3, 0, 0]) + bytes([255, 0, 9, 255] * 4) + png
    sizes = [48, 32, 6, 16, len(png)]
    places = [0, 48, 80, 88, 104]
    kinds = [(5126, 4, "VEC3"), (5126, 4, "VEC2"), (5121, 6, "SCALAR"), (5121, 4, "VEC4")]
    move = {"offset": [0.5, 0.5], "rotation": 1.0, "scale": [2, 2], "texCoord": 0}
    texture = {"index": 0, "extensions": {"KHR_texture_transform": move}}
    model = {"baseColorFactor": [1, 0.5, 0, 1], "metallicFactor": 0.5, "roughnessFactor": 0.5}
    model |= {"baseColorTexture": texture, "metallicRoughnessTexture": texture}
    gltf = {
        "asset": {"version": "2.0"},
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "rotation": [0, 0, 0, 1]}],
        "meshes": [
            {"primitives": [{"attributes": {"POSITION": 0, "TEXCOORD_0": 1, "COLOR_0": 3}, "indices": 2, "material": 0}]}
        ],
        "accessors": [
            {"bufferView": n, "componentType": kind, "count": count, "type": name, "normalized": n == 3}
            for n, (kind, count, name) in enumerate(kinds)
        ],
        "bufferViews": [{"buffer": 0, "byteOffset": at, "byteLength": size} for at, size in zip(places, sizes, strict=True)],
        "buffers": [
            {"byteLength": len(data), "uri": "data:application/octet-stream;base64," + base64.b64encode(data).decode()}
        ],
        "materials": [{"name": "a", "pbrMetallicRoughness": model, "emissiveFactor": [1, 1, 1]}],
        "textures": [{"source": 0, "sampler": 0}, {"source": 1}],
        "images": [{"bufferView": 4, "mimeType": "image/png"}, {"uri": "a.png"}],
        "samplers": [{"wrapS": 33071, "wrapT": 33648}],
    }
    return {
        "looks.obj": {"looks.obj": obj.encode(), "a.mtl": mtl, "a.png": png},
        "looks.ply": {"looks.ply": ply.encode(), "a.png": png},
        "looks.off": {"looks.off": off.encode()},
        "looks.gltf": {"looks.gltf": json.dumps(gltf).encode(), "a.png": png},
    }


def make_case(rng: np.random.Generator) -> Case:
    """A file of some format, with what it refers to, some of it damaged."""
    by_suffix = seeds()
    suffix = ("gltf", "obj", "ply", "stl", "off", "gltf", "glb")[rng.integers(7)]
    chosen = by_suffix[suffix][rng.integers(len(by_suffix[suffix]))]
    names = list(chosen)
    arrays = dict(chosen)
    for _ in range((1, 1, 1, 2, 4)[rng.integers(5)]):
        name = names[0] if len(names) == 1 or rng.random() < 0.6 else names[rng.integers(1, len(names))]
        mutate = (
            changed_json if name.endswith(("gltf", "glb")) and rng.random() < 0.8 else MUTATIONS[rng.integers(len(MUTATIONS))]
        )
        arrays[name] = mutate(rng, arrays[name])
    options = {"suffix": suffix, "name": names[0], "materials": bool(rng.random() < 0.8)}
    return Case("loaders", options, {name: np.frombuffer(data, dtype=np.uint8) for name, data in arrays.items()})


def changed_json(rng: np.random.Generator, data: bytes) -> bytes:
    """A file of glTF in which a value, or some bytes of a buffer, are others."""
    if data[:4] == b"glTF":
        end, size = (int.from_bytes(data[at : at + 4], "little") for at in (8, 12))
        text, rest = changed_json(rng, data[20 : 20 + size]), data[20 + size : end]
        text += b" " * (-len(text) % 4)
        length = 20 + len(text) + len(rest)
        return data[:8] + length.to_bytes(4, "little") + len(text).to_bytes(4, "little") + data[16:20] + text + rest
    try:
        document = json.loads(data)
    except ValueError:
        return MUTATIONS[rng.integers(len(MUTATIONS))](rng, data)
    if rng.random() < 0.2 and changed_buffer(rng, document):
        return json.dumps(document).encode()
    holder, key = document, None
    while isinstance(holder, (dict, list)) and holder and (key is None or rng.random() < 0.85):
        keys = list(holder) if isinstance(holder, dict) else list(range(len(holder)))
        inner = holder[key] if key is not None else holder
        if not isinstance(inner, (dict, list)) or not inner:
            break
        holder = inner
        keys = list(holder) if isinstance(holder, dict) else list(range(len(holder)))
        key = keys[rng.integers(len(keys))]
    if key is None:
        return data
    kind = rng.integers(4)
    if kind == 0:
        del holder[key]
    elif kind == 1 and isinstance(holder, list):
        holder.append(holder[key])
    else:
        holder[key] = VALUES[rng.integers(len(VALUES))]
    return json.dumps(document).encode()


def changed_buffer(rng: np.random.Generator, document: Any) -> bool:
    """Changes bytes of a buffer inside; False if there is none."""
    buffers = document.get("buffers") if isinstance(document, dict) else None
    if not isinstance(buffers, list) or not buffers or not isinstance(buffers[0], dict):
        return False
    head, comma, body = str(buffers[0].get("uri")).partition(";base64,")
    if not comma:
        return False
    try:
        data = base64.b64decode(body)
    except ValueError:
        return False
    data = MUTATIONS[rng.integers(len(MUTATIONS))](rng, data)
    buffers[0]["uri"] = head + comma + base64.b64encode(data).decode()
    return True


def run_case(case: Case) -> str:
    """Reads the file, and looks at what is read."""
    options = case.options
    files = {name: array.tobytes() for name, array in case.arrays.items()}
    source = MemorySource(Path(options["name"]), options["materials"], files=files)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            found = parse_mesh(files[options["name"]], options["suffix"], source)
            mesh = wrt.TriangleMesh(found.vertices, found.faces, up=found.up)
        except ValueError as error:
            if not str(error):
                raise WrongAnswer("an error without a message") from error
            return "refused"
    check(found, mesh)
    return "read"


def check(found: FileMesh, mesh: wrt.TriangleMesh) -> None:
    """Raises `WrongAnswer` if materials do not fit the triangles."""
    looks, count = found.materials, mesh.triangle_count
    if looks is None:
        return
    if looks.of_face is not None and not (
        looks.of_face.shape == (count,) and looks.of_face.min() >= 0 and looks.of_face.max() < len(looks.materials)
    ):
        raise WrongAnswer("materials of faces do not fit")
    for name, width in (("corner_uv", 2), ("corner_color", 3)):
        values = getattr(looks, name)
        if values is not None and not (
            values.shape == (count, 3, width) and values.dtype == np.float32 and np.isfinite(values).all()
        ):
            raise WrongAnswer(f"{name} does not fit: {values.dtype}, {values.shape}")
