"""The JSON of a glTF file, its buffers, and accessors as arrays."""

from __future__ import annotations

import base64
import binascii
import json
from typing import Any
from urllib.parse import unquote, unquote_to_bytes

import numpy as np

from wrt.meshes.files.mesh_source import MeshSource

__all__ = ["Document"]

COMPONENTS = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
LARGEST = {"i1": 127.0, "u1": 255.0, "<i2": 32767.0, "<u2": 65535.0}
"""What 1 is, in normalised integers."""

MAX_ZEROS = 1 << 24
"""Rows of an accessor that has no data but those of `sparse`: a small file must not ask for much memory."""

READ_EXTENSIONS = frozenset(
    {"KHR_mesh_quantization", "KHR_texture_transform", "EXT_mesh_gpu_instancing", "EXT_texture_webp", "KHR_lights_punctual"}
)
"""Required extensions of files that are read as they should be; lights are no part of meshes."""

LOOKS = ("KHR_materials_", "KHR_texture_basisu", "EXT_texture_avif", "MSFT_texture_dds")
"""Extensions that change the looks of surfaces and not their shape."""

DECODERS = {
    "KHR_draco_mesh_compression": "without Draco compression",
    "EXT_meshopt_compression": "without meshopt compression",
    "KHR_meshopt_compression": "without meshopt compression",
}


class Document:
    """A glTF file.

    Args:
        data: of the file, text or binary.
        source: where it lies.

    Raises:
        ValueError: it is no glTF 2.0, is cut off, or requires an extension that is not supported.
    """

    def __init__(self, data: bytes, source: MeshSource) -> None:
        self.source = source
        text, self._binary = _chunks(data) if data[:4] == b"glTF" else (data, None)
        try:
            self.json = json.loads(text.decode("utf-8-sig"))
        except (ValueError, RecursionError) as error:
            raise ValueError(f"its JSON cannot be read ({error}); is the file complete?") from None
        if not isinstance(self.json, dict):
            raise ValueError("its JSON is no object")
        asset = self.json.get("asset")
        version = asset.get("version") if isinstance(asset, dict) else None
        if not isinstance(version, str) or not version.startswith("2."):
            raise ValueError(f"it is glTF of version {version!r}, and not of version 2")
        self._check_extensions()
        self._buffers: dict[int, bytes] = {}
        self._arrays: dict[int, np.ndarray] = {}

    def _check_extensions(self) -> None:
        required = self.json.get("extensionsRequired", [])
        names = [name for name in required if isinstance(name, str)] if isinstance(required, list) else []
        unknown = [name for name in names if name not in READ_EXTENSIONS and not name.startswith(LOOKS)]
        if unknown:
            remedy = next((DECODERS[name] for name in unknown if name in DECODERS), "without it")
            raise ValueError(f"it requires the extension {', '.join(unknown)}, which is not supported; export it {remedy}")
        looks = [name for name in names if name.startswith(LOOKS)]
        if looks and self.source.materials is not False:
            self.source.warn(
                f"it requires {', '.join(looks)}, of which only what other materials have is read; looks may differ"
            )

    def list_of(self, name: str) -> list[Any]:
        """A list at the top of the file; empty if there is none."""
        found = self.json.get(name, [])
        if not isinstance(found, list):
            raise ValueError(f"'{name}' is no list")
        return found

    def item(self, name: str, index: Any) -> dict[str, Any]:
        """A member of such a list."""
        found = self.list_of(name)
        if isinstance(index, bool) or not isinstance(index, int) or not 0 <= index < len(found):
            raise ValueError(f"it refers to {name}[{index!r}], and there are {len(found)}")
        if not isinstance(found[index], dict):
            raise ValueError(f"{name}[{index}] is no object")
        return found[index]

    # -- bytes -------------------------------------------------------------------------------------------------------------

    def buffer(self, index: Any) -> bytes:
        """The bytes of a buffer."""
        item = self.item("buffers", index)
        if index not in self._buffers:
            uri = item.get("uri")
            if uri is None:
                if index != 0 or self._binary is None:
                    raise ValueError(f"buffers[{index}] has no data: neither a uri nor a binary chunk")
                self._buffers[index] = self._binary
            else:
                self._buffers[index] = self.of_uri(uri, f"buffers[{index}]")
            length = _whole(item, "byteLength", f"buffers[{index}]")
            if len(self._buffers[index]) < length:
                raise ValueError(
                    f"buffers[{index}] has {len(self._buffers[index])} of {length} bytes; are the file and "
                    "its buffers complete?"
                )
        return self._buffers[index]

    def of_uri(self, uri: Any, what: str) -> bytes:
        """What a URI holds or names: "data:", or a path relative to the file.

        Raises:
            FileNotFoundError, ValueError: as `MeshSource.referenced`; the URI is broken.
        """
        if not isinstance(uri, str):
            raise ValueError(f"the uri of {what} is no text")
        if not uri.startswith("data:"):
            return self.source.referenced(unquote(uri), f"the uri of {what}")
        head, comma, body = uri[5:].partition(",")
        if not comma:
            raise ValueError(f"the uri of {what} has no data behind its type")
        if not head.endswith(";base64"):
            return unquote_to_bytes(body)
        try:
            return base64.b64decode(unquote(body))
        except (binascii.Error, ValueError) as error:
            raise ValueError(f"the uri of {what} is no base64 ({error})") from None

    def view(self, index: Any) -> tuple[bytes, int, int, int]:
        """A buffer view: the buffer, and its first byte, its length and its stride, 0 for none."""
        item = self.item("bufferViews", index)
        what = f"bufferViews[{index}]"
        data = self.buffer(item.get("buffer"))
        begin, length, stride = (
            _whole(item, "byteOffset", what, 0),
            _whole(item, "byteLength", what),
            _whole(item, "byteStride", what, 0),
        )
        if begin + length > len(data):
            raise ValueError(f"{what} ends at byte {begin + length} of a buffer of {len(data)}")
        return data, begin, length, stride

    # -- arrays ------------------------------------------------------------------------------------------------------------

    def accessor(self, index: Any, types: tuple[str, ...], what: str) -> np.ndarray:
        """(N, width) numbers of an accessor, as stored; normalised integers as float64.

        Args:
            index: of the accessor.
            types: those that are right here, such as ("VEC3",).
            what: to call it in messages.

        Raises:
            ValueError: it does not exist, is of another type, has no data, or reaches out of its buffer.
        """
        item = self.item("accessors", index)
        if item.get("type") not in types:
            raise ValueError(f"{what} is an accessor of type {item.get('type')!r}, and not {' or '.join(types)}")
        if index not in self._arrays:
            self._arrays[index] = self._read(item, f"accessors[{index}]")
        return self._arrays[index]

    def _read(self, item: dict[str, Any], what: str) -> np.ndarray:
        kind, width = _component(item, what), WIDTHS[item["type"]]
        count = _whole(item, "count", what)
        sparse = item.get("sparse")
        if item.get("bufferView") is not None:
            values = self._rows(item, count, kind, width, what)
        elif sparse is None:
            raise ValueError(f"{what} has no data; an extension may hold it in a compressed form that is not read")
        elif count > MAX_ZEROS:
            raise ValueError(f"{what} has {count} rows without data, and those of more than {MAX_ZEROS} are not read")
        else:
            values = np.zeros((count, width), dtype=kind)
        if sparse is not None:
            values = self._with_sparse(values, sparse, kind, width, what)
        if item.get("normalized") is True and kind in LARGEST:
            values = np.maximum(values / LARGEST[kind], -1.0)
        return values

    def _rows(self, item: dict[str, Any], count: int, kind: str, width: int, what: str) -> np.ndarray:
        data, begin, length, stride = self.view(item["bufferView"])
        offset, size = _whole(item, "byteOffset", what, 0), np.dtype(kind).itemsize * width
        stride = stride or size
        if stride < size:
            raise ValueError(f"{what} has rows of {size} bytes, one every {stride}")
        if count and offset + stride * (count - 1) + size > length:
            raise ValueError(f"{what} reaches out of its buffer view of {length} bytes; is the file complete?")
        item_size = np.dtype(kind).itemsize
        return np.ndarray((count, width), kind, data, begin + offset if count else 0, (stride, item_size))

    def _with_sparse(self, values: np.ndarray, sparse: Any, kind: str, width: int, what: str) -> np.ndarray:
        """The rows, some of them replaced."""
        count = _whole(sparse, "count", f"{what}.sparse")
        at, new = sparse["indices"], sparse["values"]
        indices = self._rows(at, count, _component(at, f"{what}.sparse.indices"), 1, f"{what}.sparse.indices")[:, 0]
        rows = self._rows(new, count, kind, width, f"{what}.sparse.values")
        if indices.dtype.kind != "u" or (count and indices.max() >= len(values)):
            raise ValueError(f"{what}.sparse replaces rows that are not there")
        values = values.copy()
        values[indices] = rows
        return values


def _component(item: dict[str, Any], what: str) -> str:
    kind = item.get("componentType")
    if isinstance(kind, bool) or not isinstance(kind, int) or kind not in COMPONENTS:
        raise ValueError(f"{what} has the component type {kind!r}; those of glTF are {', '.join(map(str, COMPONENTS))}")
    return COMPONENTS[kind]


def _whole(item: dict[str, Any], name: str, what: str, default: int | None = None) -> int:
    value = item.get(name, default)
    if isinstance(value, float) and value.is_integer():
        value = int(value)
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value < 1 << 53:
        raise ValueError(f"{what} has {name} = {value!r}, which is no whole number from 0")
    return value


def _chunks(data: bytes) -> tuple[bytes, bytes | None]:
    """JSON and binary chunk of a .glb file."""
    version, length = int.from_bytes(data[4:8], "little"), int.from_bytes(data[8:12], "little")
    if version != 2:
        raise ValueError(f"it is binary glTF of version {version}, and not of version 2")
    if length > len(data):
        raise ValueError(f"it has {len(data)} of the {length} bytes that its header announces; is the file complete?")
    chunks, at = {}, 12
    while at + 8 <= length:
        size, kind = int.from_bytes(data[at : at + 4], "little"), data[at + 4 : at + 8]
        if at + 8 + size > len(data):
            raise ValueError(f"a chunk of {size} bytes ends behind the end of the file; is the file complete?")
        chunks.setdefault(kind, data[at + 8 : at + 8 + size])
        at += 8 + size
    if b"JSON" not in chunks:
        raise ValueError("it has no chunk of JSON")
    return chunks[b"JSON"], chunks.get(b"BIN\0")
