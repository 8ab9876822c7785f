"""What a scene can do about things that move, frame by frame.

A cloth waves, or a skinned figure walks, in the atrium. Every way to follow the motion updates its scene and traces a view of
each frame, and is compared with a tree that was built for the frame. Each frame's least time counts; with one thread it is that
thread's own time, which nobody else on the machine disturbs. Building while tracing takes two, so there it is always wall time.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from time import perf_counter, thread_time
from typing import Any

import numpy as np

from wrt.accelerators.tree_descriptions import Bvh, KdTree
from wrt.imaging.cameras import PinholeCamera
from wrt.kernels.runtime.launch import use_threads
from wrt.meshes.instance import Instance
from wrt.meshes.mesh import TriangleMesh
from wrt.meshes.skeleton import Skeleton
from wrt.moving.fuzzy_scene import FuzzyScene
from wrt.moving.grouped_scene import GroupedScene
from wrt.moving.skinned_scene import SkinnedScene
from wrt.scene.scene import Scene
from wrt.scenes.animations import Animation, walking_figure, waving_cloth

REFERENCE = "build, bvh"
"""The way that all figures refer to."""

CLUSTERS = 12
"""Clusters that are looked for in the cloth."""

BESIDE_THE_FOUNTAIN = (-2.0, -3.0, -0.5)
"""Where the figure walks, on the floor of the court."""

ANIMATIONS: dict[str, Callable[[int, int], Animation]] = {
    "cloth": lambda frames, detail: waving_cloth(frames, 4 * detail),
    "figure": lambda frames, detail: walking_figure(frames, detail).moved(BESIDE_THE_FOUNTAIN),
}
"""By name: (frames, detail) -> animation."""

Show = Callable[[int], Scene]
"""frame -> the scene as it is then; frames come in order."""

Answer = tuple[np.ndarray, np.ndarray]
"""Triangles, numbered through the scene, -1 for none, and t of a view's rays."""


@dataclass(frozen=True)
class Stage:
    """What moves, and where.

    Attributes:
        static: the mesh that stays.
        animation: the one that moves.
    """

    static: TriangleMesh
    animation: Animation

    def meshes(self, frame: int) -> list[TriangleMesh]:
        """All that is there in a frame."""
        return [self.static, self.animation.mesh(frame)]


def by_updates(accelerator: str | KdTree, rebuild: str) -> Callable[[Stage], Show]:
    """One tree, updated for each frame."""

    def start(stage: Stage) -> Show:
        scene = Scene(stage.meshes(0), accelerator, device="cpu")

        def show(frame: int) -> Scene:
            scene.update(1, vertices=stage.animation.frames[frame], rebuild=rebuild)
            return scene

        return show

    return start


def by_two_levels(stage: Stage) -> Show:
    """A tree for what stays and one for what moves."""
    scene = Scene([Instance(mesh) for mesh in stage.meshes(0)], device="cpu")

    def show(frame: int) -> Scene:
        scene.update(1, vertices=stage.animation.frames[frame])
        return scene

    return show


def by_groups(accelerator: str, **options: Any) -> Callable[[Stage], Show]:
    """The same, put together to one tree; options: of `wrt.moving.GroupedScene`."""

    def start(stage: Stage) -> Show:
        scene = GroupedScene(stage.meshes(0), accelerator, device="cpu", **options)

        def show(frame: int) -> Scene:
            scene.update({1: stage.animation.frames[frame]})
            return scene

        return show

    return start


def by_fuzzy_boxes(stage: Stage, accelerator: Bvh | KdTree | None = None) -> Show:
    """A tree for all frames. What stays is a cluster that does not move; the others are bones, or looked for."""
    from wrt.builders.motion_clusters import decompose

    animation, static = stage.animation, stage.static
    maps = animation.bones
    if maps is None:
        found = decompose(animation.frames, animation.faces, CLUSTERS, 0.0, 0)
        maps = np.zeros((*found.matrices.shape[:2], 4, 4))
        maps[..., :3, :3], maps[..., :3, 3], maps[..., 3, 3] = found.matrices, found.origins, 1.0
    still = np.tile(np.eye(4), (len(animation), 1, 1, 1))
    frames = [np.concatenate([static.vertices, vertices]) for vertices in animation.frames]
    faces = np.concatenate([static.faces, animation.faces + static.vertex_count])
    maps = np.concatenate([still, maps], axis=1)
    scene = FuzzyScene(np.array(frames), faces, transforms=maps, accelerator=accelerator, device="cpu")

    def show(frame: int) -> Scene:
        scene.show(frame)
        return scene

    return show


def by_limits_of_joints(stage: Stage) -> Show:
    """A tree for all poses that joints allow. What stays is a bone that does not move."""
    animation, static, skin = stage.animation, stage.static, stage.animation.skin
    weights = np.zeros((static.vertex_count + len(skin.vertices), len(skin.skeleton) + 1))
    weights[: static.vertex_count, -1], weights[static.vertex_count :, :-1] = 1.0, skin.weights
    skeleton = Skeleton(
        np.append(skin.skeleton.parents, -1),
        np.concatenate([skin.skeleton.joints, np.zeros((1, 3))]),
        np.concatenate([skin.skeleton.limits, np.zeros((1, 3, 2))]),
    )
    faces = np.concatenate([static.faces, animation.faces + static.vertex_count])
    scene = SkinnedScene(np.concatenate([static.vertices, skin.vertices]), faces, weights, skeleton, device="cpu")

    def show(frame: int) -> Scene:
        scene.pose(np.concatenate([animation.bones[frame], np.eye(4)[None]]))
        return scene

    return show


LIMITS = "limits of joints"
"""The way that needs a skin over bones."""

WAYS: dict[str, Callable[[Stage], Show]] = {
    REFERENCE: by_updates("bvh", "always"),
    "refit, bvh": by_updates("bvh", "never"),
    "refit or build, bvh": by_updates("bvh", "auto"),
    "build, kdtree": by_updates("kdtree", "always"),
    "refill or build, kdtree": by_updates("kdtree", "auto"),
    "lazy kdtree": by_updates(KdTree(builder="lazy"), "always"),
    "two levels": by_two_levels,
    "groups": by_groups("bvh"),
    "groups, kdtree": by_groups("kdtree"),
    "static and moving kdtree": by_groups("kdtree", top="list"),
    "moving triangles one by one": by_groups("kdtree", top="list", accelerators={1: KdTree(max_depth=0)}),
    "fuzzy boxes": by_fuzzy_boxes,
    "fuzzy boxes, kdtree": partial(by_fuzzy_boxes, accelerator=KdTree()),
    LIMITS: by_limits_of_joints,
}
"""Ways to follow a motion: stage -> what shows a frame."""


@dataclass
class WayFigures:
    """What a way to follow a motion costs.

    Attributes:
        way: key in `WAYS`, or "building while tracing".
        start: seconds before the first frame.
        update: seconds of each frame's update; 0 where it goes on beside tracing.
        trace: seconds of tracing each frame.
        same_triangle: least share, over all frames, of rays with the same triangle, or none, as in a tree built for the frame.
        same_bits: the same of rays with the same triangle at the same t.
    """

    way: str
    start: float
    update: list[float] = field(default_factory=list)
    trace: list[float] = field(default_factory=list)
    same_triangle: float = 1.0
    same_bits: float = 1.0

    @property
    def frames_per_second(self) -> float:
        """Of all frames together."""
        return len(self.trace) / (sum(self.update) + sum(self.trace))

    def compare(self, got: Answer, wanted: Answer) -> None:
        """Notes how a frame's answer agrees with that of a tree built for it."""
        same = got[0] == wanted[0]
        self.same_triangle = min(self.same_triangle, float(same.mean()))
        self.same_bits = min(self.same_bits, float((same & (got[1] == wanted[1])).mean()))

    def add(self, frame: int, update: float, trace: float) -> None:
        """Notes a frame's times, if they are its best so far."""
        if frame == len(self.trace):
            self.update.append(update)
            self.trace.append(trace)
        elif update + trace < self.update[frame] + self.trace[frame]:
            self.update[frame], self.trace[frame] = update, trace


def answer(scene: Scene, camera: PinholeCamera) -> Answer:
    """What a view's rays meet."""
    hits = scene.intersect(camera.rays())
    return hits.batch.primitive.numpy(), hits.batch.t.numpy()


def compare_ways(
    stage: Stage,
    camera: PinholeCamera,
    ways: Sequence[str] = tuple(WAYS),
    *,
    rounds: int = 1,
    threads: int = 1,
    on_turn: Callable[[str], None] = lambda name: None,
) -> list[WayFigures]:
    """Follows the motion in every way, and once more building while the last frame is traced.

    A cloth has no joints, so that way is left out.

    Raises:
        ValueError: an unknown way.
    """
    from wrt.tables import lookup

    found, clock = [], thread_time if threads == 1 else perf_counter
    with use_threads(threads):
        expected = [answer(Scene(stage.meshes(frame), device="cpu"), camera) for frame in range(len(stage.animation))]
        for name in ways:
            way = lookup(WAYS, name, "way")
            if name == LIMITS and stage.animation.skin is None:
                continue
            on_turn(name)
            start = clock()
            show = way(stage)
            figures = WayFigures(name, clock() - start)
            for _ in range(rounds):
                follow(show, camera, expected, figures, clock)
            found.append(figures)
        on_turn("building while tracing")
        found.append(follow_behind(stage, camera, expected, rounds))
    return found


def follow(show: Show, camera: PinholeCamera, expected: list[Answer], figures: WayFigures, clock: Callable[[], float]) -> None:
    """Shows and traces all frames once."""
    answer(show(0), camera)
    for frame, wanted in enumerate(expected):
        start = clock()
        scene = show(frame)
        middle = clock()
        got = answer(scene, camera)
        figures.add(frame, middle - start, clock() - middle)
        figures.compare(got, wanted)


def follow_behind(
    stage: Stage, camera: PinholeCamera, expected: list[Answer], rounds: int, accelerator: str = "bvh"
) -> WayFigures:
    """Builds the tree of each frame while the one before is traced."""
    start = perf_counter()
    scene = Scene(stage.meshes(0), accelerator, device="cpu")
    figures, frames = WayFigures("building while tracing", perf_counter() - start), stage.animation.frames
    for _ in range(rounds):
        scene.update(1, vertices=frames[0], rebuild="always")
        answer(scene, camera)
        for frame, wanted in enumerate(expected):
            start = perf_counter()
            with scene.updating(1, vertices=frames[(frame + 1) % len(frames)], rebuild="always"):
                got = answer(scene, camera)
            figures.add(frame, 0.0, perf_counter() - start)
            figures.compare(got, wanted)
    return figures
