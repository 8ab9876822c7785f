"""Writes small glTF files, with whatever is wanted in them."""

from __future__ import annotations

import base64
import json
from pathlib import Path
from typing import Any

import numpy as np

COMPONENTS = {"i1": 5120, "u1": 5121, "i2": 5122, "u2": 5123, "u4": 5125, "f4": 5126}


class GltfWriter:
    """Collects arrays in one buffer, and writes a file."""

    def __init__(self) -> None:
        self.data, self.views, self.accessors = b"", [], []

    def view(self, array: np.ndarray, **more: Any) -> int:
        """A view of the buffer; its number."""
        array = np.ascontiguousarray(array)
        self.views.append({"buffer": 0, "byteOffset": len(self.data), "byteLength": array.nbytes, **more})
        self.data += array.tobytes() + bytes(-array.nbytes % 4)
        return len(self.views) - 1

    def accessor(self, array: np.ndarray, kind: str, **more: Any) -> int:
        """An accessor of an array with a view of its own; its number."""
        array = np.asarray(array)
        found = {"componentType": COMPONENTS[array.dtype.str[1:]], "count": len(array), "type": kind}
        self.accessors.append(found | {"bufferView": self.view(array)} | more)
        return len(self.accessors) - 1

    def bare(self, **accessor: Any) -> int:
        """An accessor as given; its number."""
        self.accessors.append(accessor)
        return len(self.accessors) - 1

    def primitive(self, vertices: np.ndarray, faces: np.ndarray | None, **more: Any) -> dict[str, Any]:
        """A primitive of float32 positions and uint16 indices."""
        found = {"attributes": {"POSITION": self.accessor(np.asarray(vertices, np.float32), "VEC3")}}
        if faces is not None:
            found["indices"] = self.accessor(np.asarray(faces, np.uint16).ravel(), "SCALAR")
        attributes = more.pop("attributes", {})
        found["attributes"] |= attributes
        return found | more

    def document(self, *primitives: dict[str, Any], **parts: Any) -> dict[str, Any]:
        """The JSON: one mesh of these primitives at one node, unless `parts` say otherwise; the buffer is inside."""
        found = {"asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}]}
        found |= {"meshes": [{"primitives": list(primitives)}], "accessors": self.accessors, "bufferViews": self.views}
        uri = "data:application/octet-stream;base64," + base64.b64encode(self.data).decode()
        return found | {"buffers": [{"byteLength": len(self.data), "uri": uri}]} | parts

    def save(self, path: Path, *primitives: dict[str, Any], **parts: Any) -> None:
        """Writes a .gltf file."""
        path.write_text(json.dumps(self.document(*primitives, **parts)))

    def glb(self, *primitives: dict[str, Any], **parts: Any) -> bytes:
        """The bytes of a .glb file."""
        document = self.document(*primitives, **parts)
        del document["buffers"][0]["uri"]
        text = json.dumps(document).encode()
        text += b" " * (-len(text) % 4)
        binary = self.data + bytes(-len(self.data) % 4)
        chunks = len(text).to_bytes(4, "little") + b"JSON" + text + len(binary).to_bytes(4, "little") + b"BIN\0" + binary
        return b"glTF" + (2).to_bytes(4, "little") + (12 + len(chunks)).to_bytes(4, "little") + chunks
