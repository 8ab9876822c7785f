"""The models of `wrt view`: files, folders whose meshes are the frames of an animation, or a built-in scene."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import numpy as np

from wrt.cli.arguments import busy, load_mesh, make_scene
from wrt.cli.cloud_models import refuse_cloud

if TYPE_CHECKING:
    from wrt.meshes.mesh import TriangleMesh
    from wrt.scene.scene import Scene
    from wrt.scenes import BuiltinScene

__all__ = ["Models", "load_models"]


@dataclass(frozen=True)
class Models:
    """What is to be shown.

    Attributes:
        meshes: one of each model; of an animation, the first frame.
        builtin: the built-in scene, if it is one.
        moving: (V, 3) vertices of all frames, for each of `meshes` that moves, by its index.
    """

    meshes: list[TriangleMesh]
    builtin: BuiltinScene | None = None
    moving: dict[int, list[np.ndarray]] = field(default_factory=dict)

    @property
    def frames(self) -> int:
        """Of the longest animation; the others begin again. 0 if nothing moves."""
        return max(map(len, self.moving.values()), default=0)

    def scene(self, given: Mapping[str, Any], fuzzy: bool) -> Scene:
        """The scene of the first frame: a `wrt.moving.FuzzyScene` if asked for, else a `wrt.moving.GroupedScene` if one of
        several meshes moves, else a `wrt.Scene`.

        Args:
            given: the options of the command.
            fuzzy: whether one tree serves all frames.
        """
        if not fuzzy and (not self.moving or len(self.meshes) == 1):
            return make_scene(self.meshes, given)
        if fuzzy and not (self.moving and len(self.meshes) == 1):
            raise click.UsageError("--fuzzy is for the frames of a single mesh: give one folder, or --animate and its files")
        from wrt.accelerators.accelerator import resolve_accelerator
        from wrt.moving.fuzzy_scene import FuzzyScene
        from wrt.moving.grouped_scene import GroupedScene

        accelerator = None if given["accelerator"] == "auto" else resolve_accelerator(given["accelerator"])
        options = {"device": given["device"], "num_threads": given["threads"]}
        with busy("building the tree"):
            if fuzzy:
                return FuzzyScene(np.stack(self.moving[0]), self.meshes[0].faces, accelerator=accelerator, **options)  # type: ignore[arg-type]
            return GroupedScene(self.meshes, accelerator or "auto", **options)

    def animation(self, fuzzy: bool) -> Callable[[Any, int], None] | None:
        """What moves the scene of `scene` to a frame; None if nothing moves, and for a `FuzzyScene`, which knows how."""
        if not self.moving or fuzzy:
            return None
        if len(self.meshes) == 1:
            return lambda scene, frame: scene.update(0, vertices=self.moving[0][frame])
        return lambda scene, frame: scene.update({i: frames[frame % len(frames)] for i, frames in self.moving.items()})


def load_models(models: tuple[Path, ...], given: Mapping[str, Any], animate: bool) -> Models:
    """Reads the models.

    Args:
        models: files and folders; none for a built-in scene.
        given: the options of the command.
        animate: whether all models together are the frames of one mesh.

    Raises:
        click.UsageError: frames that do not fit together, or none.
        FileNotFoundError, ValueError: as in `wrt.TriangleMesh.load`.
    """
    if not models:
        if animate:
            raise click.UsageError("--animate needs the frames: MODEL... or a folder")
        mesh, builtin = load_mesh({**given, "model": None}, materials=True)
        return Models([mesh], builtin)
    for model in models:
        refuse_cloud(model, "view")
    groups = [files_of(model) for model in models]
    if animate:
        groups = [[file for group in groups for file in group]]
    meshes, moving = [], {}
    for number, files in enumerate(groups):
        first, frames = read_frames(files, given)
        meshes.append(first)
        if len(frames) > 1:
            moving[number] = frames
    return Models(meshes, None, moving)


def files_of(model: Path) -> list[Path]:
    """The file itself, or the mesh files of a folder in the order of their names, in which numbers count as such."""
    if not model.is_dir():
        return [model]
    import trimesh

    known = set(trimesh.available_formats())
    found = [file for file in model.iterdir() if file.is_file() and file.suffix.lower().lstrip(".") in known]
    if not found:
        raise click.UsageError(f"'{model}' has no mesh files; a folder's meshes are the frames of an animation")
    return sorted(found, key=lambda file: [int(part) if part.isdigit() else part for part in re.split(r"(\d+)", file.name)])


def read_frames(files: list[Path], given: Mapping[str, Any]) -> tuple[TriangleMesh, list[np.ndarray]]:
    """The first mesh, and the (V, 3) vertices of all."""
    first, frames = None, []
    for file in files:
        mesh, _ = load_mesh({**given, "model": file}, materials=True)
        first = first or mesh
        if mesh.vertices.shape != first.vertices.shape or not np.array_equal(mesh.faces, first.faces):
            raise click.UsageError(
                f"'{file}' has other triangles than '{files[0]}': the frames of an animation share their triangles"
            )
        frames.append(np.asarray(mesh.vertices))
    return first, frames
