"""Valid glTF files that readers get wrong, each with what is in it: `GLTF_FILES`."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np

from support.hostile_files import HostileFile
from support.hostile_shapes import CORNERS, TRIANGLES
from support.written_gltf import GltfWriter

GLTF_FILES: list[HostileFile] = []
TURN = np.array([[0, -1, 0, 5], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]], dtype=np.float64)


def cube(name: str, copies: float = 1, *, triangles: int | None = None, bounds=None, area: float | None = None) -> Callable:
    """Adds a file of cubes: what is decorated takes a writer and a path. The volume is `copies`."""

    def keep(function: Callable[[GltfWriter, Path], Any]) -> Callable:
        count = int(12 * copies) if triangles is None else triangles
        GLTF_FILES.append(HostileFile(name, lambda path: function(GltfWriter(), path), count, copies, area, bounds))
        return function

    return keep


def quantised(g: GltfWriter, path: Path, dtype: str, largest: int, **node: Any) -> None:
    stored = np.zeros((8, 4), dtype=dtype)
    stored[:, :3] = CORNERS * largest
    position = g.bare(
        bufferView=g.view(stored, byteStride=stored.strides[0]),
        componentType={"u2": 5123, "i1": 5120, "u1": 5121}[dtype],
        normalized=largest > 1,
        count=8,
        type="VEC3",
    )
    indices = g.accessor(TRIANGLES.astype("u2").ravel(), "SCALAR")
    names = {"extensionsUsed": ["KHR_mesh_quantization"], "extensionsRequired": ["KHR_mesh_quantization"]}
    g.save(path, {"attributes": {"POSITION": position}, "indices": indices}, nodes=[{"mesh": 0, **node}], **names)


@cube("quantised_shorts.gltf", bounds=[[0, 0, 0], [1, 1, 1]])
def _(g, path):
    quantised(g, path, "u2", 65535)


@cube("quantised_bytes.gltf", 8.0, triangles=12, bounds=[[-1, 0, 0], [1, 2, 2]])
def _(g, path):
    quantised(g, path, "i1", 127, scale=[2, 2, 2], translation=[-1, 0, 0])


@cube("integers_not_normalised.gltf", bounds=[[0, 0, 0], [1, 1, 1]])
def _(g, path):
    quantised(g, path, "u1", 1)


@cube("sparse_without_view.gltf", bounds=[[0, 0, 0], [1, 1, 1]])
def _(g, path):
    places = np.flatnonzero(CORNERS.any(axis=1)).astype("u1")
    indices, values = g.view(places), g.view(CORNERS[places].astype("f4"))
    sparse = {"count": len(places), "indices": {"bufferView": indices, "componentType": 5121}, "values": {"bufferView": values}}
    position = g.bare(componentType=5126, count=8, type="VEC3", sparse=sparse)
    index = g.accessor(TRIANGLES.astype("u2").ravel(), "SCALAR")
    g.save(path, {"attributes": {"POSITION": position}, "indices": index})


@cube("sparse_over_view.gltf", bounds=[[0, 0, 0], [1, 1, 1]])
def _(g, path):
    wrong = CORNERS.astype("f4") + (np.arange(8) == 5)[:, None]
    indices, values = g.view(np.array([5], "u4")), g.view(CORNERS[5:6].astype("f4"))
    sparse = {"count": 1, "indices": {"bufferView": indices, "componentType": 5125}, "values": {"bufferView": values}}
    position = g.accessor(wrong.astype("f4"), "VEC3", sparse=sparse)
    index = g.accessor(TRIANGLES.astype("u2").ravel(), "SCALAR")
    g.save(path, {"attributes": {"POSITION": position}, "indices": index})


@cube("instances.gltf", 10.0, triangles=36, bounds=[[0, 0, 0], [8, 2, 2]])
def _(g, path):
    name = "EXT_mesh_gpu_instancing"
    shifts = g.accessor(np.array([[0, 0, 0], [3, 0, 0], [6, 0, 0]], "f4"), "VEC3")
    scales = g.accessor(np.array([[1, 1, 1], [1, 1, 1], [2, 2, 2]], "f4"), "VEC3")
    node = {"mesh": 0, "extensions": {name: {"attributes": {"TRANSLATION": shifts, "SCALE": scales}}}}
    g.save(path, g.primitive(CORNERS, TRIANGLES), nodes=[node], extensionsUsed=[name], extensionsRequired=[name])


def flat(name: str, indices: list[int], mode: int, triangles: int, area: float) -> None:
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0], [0, 2, 0], [1, 2, 0]], "f4")

    def write(path: Path) -> None:
        g = GltfWriter()
        g.save(path, g.primitive(points, np.array(indices), mode=mode))

    GLTF_FILES.append(HostileFile(name, write, triangles, 0.0, area))


flat("fan.gltf", [0, 1, 3, 2], 6, 2, 1.0)
flat("strip.gltf", [0, 1, 2, 3, 4, 5], 5, 4, 2.0)


@cube("strips_of_a_cube.gltf")
def _(g, path):
    strips = [g.primitive(CORNERS[list(quad)], np.arange(4), mode=5) for quad in ((0, 1, 2, 3), (4, 6, 5, 7), (0, 4, 1, 5))]
    strips += [g.primitive(CORNERS[list(quad)], np.arange(4), mode=5) for quad in ((2, 3, 6, 7), (0, 2, 4, 6), (1, 5, 3, 7))]
    g.save(path, *strips)


@cube("without_indices.gltf")
def _(g, path):
    g.save(path, g.primitive(CORNERS[TRIANGLES.ravel()], None))


@cube("indices_of_bytes.gltf")
def _(g, path):
    g.save(path, g.primitive(CORNERS, None, indices=g.accessor(TRIANGLES.astype("u1").ravel(), "SCALAR")))


@cube("indices_of_ints.gltf")
def _(g, path):
    g.save(path, g.primitive(CORNERS, None, indices=g.accessor(TRIANGLES.astype("u4").ravel(), "SCALAR")))


@cube("interleaved.gltf")
def _(g, path):
    rows = np.zeros(8, dtype=[("normal", "f4", 3), ("position", "f4", 3), ("id", "u4")])
    rows["position"], rows["normal"] = CORNERS, 99.0
    view = g.view(rows.view("u1"), byteStride=rows.itemsize)
    position = g.bare(bufferView=view, byteOffset=12, componentType=5126, count=8, type="VEC3")
    index = g.accessor(np.concatenate([[9, 9], TRIANGLES.ravel()]).astype("u2"), "SCALAR", byteOffset=4, count=36)
    g.save(path, {"attributes": {"POSITION": position}, "indices": index})


@cube("matrices_and_parts.gltf", 6.0, triangles=12, bounds=[[2, 0, 0], [5, 2, 1]])
def _(g, path):
    nodes = [{"children": [1], "matrix": TURN.T.ravel().tolist()}, {"mesh": 0, "scale": [2, 3, 1]}]
    g.save(path, g.primitive(CORNERS, TRIANGLES), nodes=nodes)


@cube("mirrored.gltf", bounds=[[-1, 0, 0], [0, 1, 1]])
def _(g, path):
    g.save(path, g.primitive(CORNERS, TRIANGLES), nodes=[{"mesh": 0, "scale": [-1, 1, 1]}])


@cube("quaternion_of_length_two.gltf", bounds=[[-1, 0, 0], [0, 1, 1]])
def _(g, path):
    half = float(np.sqrt(0.5)) * 2
    g.save(path, g.primitive(CORNERS, TRIANGLES), nodes=[{"mesh": 0, "rotation": [0, 0, half, half]}])


@cube("second_scene.gltf", bounds=[[7, 0, 0], [8, 1, 1]])
def _(g, path):
    nodes = [{"mesh": 0}, {"mesh": 0, "translation": [7, 0, 0]}]
    g.save(path, g.primitive(CORNERS, TRIANGLES), nodes=nodes, scenes=[{"nodes": [0]}, {"nodes": [1]}], scene=1)


@cube("without_scenes.gltf", 2)
def _(g, path):
    document = g.document(g.primitive(CORNERS, TRIANGLES), nodes=[{"mesh": 0, "children": [1]}, {"mesh": 0}])
    del document["scenes"], document["scene"]
    path.write_text(json.dumps(document))


@cube("shared_mesh.gltf", 3)
def _(g, path):
    nodes = [{"mesh": 0, "translation": [3 * k, 0, 0]} for k in range(3)]
    g.save(path, g.primitive(CORNERS, TRIANGLES), nodes=nodes, scenes=[{"nodes": [0, 1, 2]}])


@cube("chain_of_3000_nodes.gltf", bounds=[[3000, 0, 0], [3001, 1, 1]])
def _(g, path):
    nodes = [{"translation": [1, 0, 0], "children": [k + 1]} for k in range(3000)] + [{"mesh": 0}]
    g.save(path, g.primitive(CORNERS, TRIANGLES), nodes=nodes)


@cube("points_beside.gltf")
def _(g, path):
    g.save(
        path, g.primitive(CORNERS * 9, None, mode=0), g.primitive(CORNERS, TRIANGLES), g.primitive(CORNERS * 9, None, mode=3)
    )


@cube("external_buffer.gltf")
def _(g, path):
    primitive = g.primitive(CORNERS, TRIANGLES)
    (path.parent / "the buffer.bin").write_bytes(g.data + b"padding")
    g.save(path, primitive, buffers=[{"byteLength": len(g.data), "uri": "the%20buffer.bin"}])


@cube("percent_encoded.gltf")
def _(g, path):
    primitive = g.primitive(CORNERS, TRIANGLES)
    g.save(path, primitive, buffers=[{"byteLength": len(g.data), "uri": "data:," + quote(g.data)}])


@cube("binary.glb")
def _(g, path):
    path.write_bytes(g.glb(g.primitive(CORNERS, TRIANGLES)) + b"behind the end")


@cube("byte_order_mark.gltf")
def _(g, path):
    path.write_bytes(b"\xef\xbb\xbf" + json.dumps(g.document(g.primitive(CORNERS, TRIANGLES))).encode())


@cube("morph_target.gltf", 2.0, triangles=12, bounds=[[0, 0, 0], [2, 1, 1]])
def _(g, path):
    target = g.accessor((CORNERS * (2, 0, 0)).astype("f4"), "VEC3")
    primitive = g.primitive(CORNERS, TRIANGLES, targets=[{"POSITION": target}, {"NORMAL": target}])
    g.save(path, primitive, meshes=[{"primitives": [primitive], "weights": [0.5, 1.0]}])


@cube("skin.gltf", bounds=[[9, 2, 0], [10, 3, 1]])
def _(g, path):
    joints, weights = np.zeros((8, 4), "u1"), np.zeros((8, 4), "f4")
    joints[:, 1], weights[:, :2] = 1, 0.5
    back = np.eye(4, dtype="f4")
    back[:3, 3] = (-1, 0, 0)
    inverse = g.accessor(np.array([back.T, back.T]).reshape(2, 16).astype("f4"), "MAT4")
    attributes = {"JOINTS_0": g.accessor(joints, "VEC4"), "WEIGHTS_0": g.accessor(weights, "VEC4")}
    nodes = [{"mesh": 0, "skin": 0, "translation": [99, 0, 0]}, {"translation": [10, 0, 0], "children": [2]}]
    nodes += [{"translation": [0, 4, 0]}]
    skin = {"joints": [1, 2], "inverseBindMatrices": inverse}
    primitive = g.primitive(CORNERS, TRIANGLES, attributes=attributes)
    g.save(path, primitive, nodes=nodes, skins=[skin], scenes=[{"nodes": [0, 1]}])


@cube("compressed_with_a_fallback.gltf")
def _(g, path):
    name = "KHR_draco_mesh_compression"
    extension = {name: {"bufferView": g.view(np.zeros(16, "u1")), "attributes": {"POSITION": 0}}}
    g.save(path, g.primitive(CORNERS, TRIANGLES, extensions=extension), extensionsUsed=[name])
