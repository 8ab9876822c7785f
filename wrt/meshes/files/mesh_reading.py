"""Reads mesh files: PLY, OBJ, STL, OFF and glTF by `wrt.meshes.files`, all other formats by trimesh."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from wrt.meshes.files.mesh_source import FileMesh, MeshSource, read_regular_file

if TYPE_CHECKING:
    import trimesh

__all__ = ["OWN_FORMATS", "parse_mesh", "read_by_trimesh", "read_own_format"]

OWN_FORMATS = ("glb", "gltf", "obj", "off", "ply", "stl")


def _reader(suffix: str) -> Callable[[bytes, MeshSource], FileMesh]:
    if suffix == "ply":
        from wrt.meshes.files.ply_file import read_ply as read
    elif suffix == "obj":
        from wrt.meshes.files.obj_file import read_obj as read
    elif suffix == "stl":
        from wrt.meshes.files.stl_file import read_stl as read
    elif suffix == "off":
        from wrt.meshes.files.off_file import read_off as read
    else:
        from wrt.meshes.files.gltf.gltf_file import read_gltf as read
    return read


def read_own_format(path: Path, suffix: str, materials: bool | None, outside: bool) -> FileMesh:
    """What a file of one of `OWN_FORMATS` holds. Errors as in `wrt.TriangleMesh.load`."""
    return parse_mesh(read_regular_file(path, "a mesh file"), suffix, MeshSource(path, materials, outside))


def parse_mesh(data: bytes, suffix: str, source: MeshSource) -> FileMesh:
    """What the bytes of a file of one of `OWN_FORMATS` are. Errors as in `wrt.TriangleMesh.load`."""
    path = source.path
    try:
        return _reader(suffix)(data, source)
    except (ValueError, FileNotFoundError) as error:
        raise ValueError(f"cannot read '{path}' as .{suffix}: {error}") from error
    except (TypeError, KeyError, AttributeError, IndexError, OverflowError) as error:  # JSON of another structure
        raise ValueError(
            f"cannot read '{path}' as .{suffix}: its structure is broken ({type(error).__name__}: {error}); "
            "is the file complete?"
        ) from error


def read_by_trimesh(path: Path, suffix: str) -> trimesh.Trimesh | trimesh.Scene:
    """What trimesh reads from a file. Errors as in `wrt.TriangleMesh.load`."""
    import trimesh

    known = sorted(trimesh.available_formats())
    if suffix in ("pcd", "las", "laz"):
        raise ValueError(f"cannot read '{path}': it holds points, no mesh; read it with wrt.sensors.read_points")
    if suffix not in known:
        raise ValueError(f"cannot read '{path}': unknown mesh format '.{suffix}'; the known ones are {known}")
    try:
        loaded = trimesh.load(path, process=False)
    except (PermissionError, MemoryError):
        raise
    except Exception as error:  # the readers of thirty formats raise many types of error
        reason = f"{type(error).__name__}: {error}"
        raise ValueError(f"cannot read '{path}' as .{suffix} ({reason}); is the file complete?") from error
    if not isinstance(loaded, trimesh.Trimesh | trimesh.Scene):
        raise ValueError(f"'{path}' holds a {type(loaded).__name__} without triangles; save it as a triangle mesh")
    return loaded
