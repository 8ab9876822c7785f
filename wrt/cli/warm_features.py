"""What `wrt warm --feature` compiles: each feature is a small call of a user's, made for real.

So it compiles what a first call compiles: with few rays and with many, which are traced in different ways, in a scene of some
ten thousand triangles.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from wrt.engine.rays.rays import Rays
    from wrt.imaging.cameras import PinholeCamera
    from wrt.meshes.mesh import TriangleMesh
    from wrt.scene.scene import Scene

FEW, WIDTH, HEIGHT = 8, 160, 120
"""Rays of a small batch, and pixels of a picture, whose rays are a large one."""


class Samples:
    """A mesh, scenes of it, and rays, which features share."""

    @cached_property
    def mesh(self) -> TriangleMesh:
        """A teapot."""
        from wrt.scenes import build

        return build("teapot", level=16)

    @cached_property
    def scene(self) -> Scene:
        """A scene as `wrt.Scene(mesh)` makes it, on the CPU."""
        return self.scene_of(self.mesh)

    @cached_property
    def forest(self) -> Scene:
        """Four instances of the mesh."""
        import numpy as np

        from wrt.meshes.instance import Instance

        places = np.tile(np.eye(4), (4, 1, 1))
        places[:, 0, 3] = 8.0 * np.arange(4)
        return self.scene_of([Instance(self.mesh, place) for place in places])

    @cached_property
    def camera(self) -> PinholeCamera:
        """A camera that sees the mesh."""
        from wrt.imaging.cameras import PinholeCamera

        return PinholeCamera.framing(self.mesh, WIDTH, HEIGHT)

    def scene_of(self, geometry: Any, accelerator: Any = "auto") -> Scene:
        """A scene on the CPU."""
        from wrt.scene.scene import Scene

        return Scene(geometry, accelerator, device="cpu")

    def batches(self) -> list[Rays]:
        """Few rays; many of a picture; and many that start on surfaces and go anywhere."""
        import numpy as np

        from wrt.engine.rays.rays import Rays

        many = self.camera.rays()
        few = Rays(np.broadcast_to(many.origins, many.directions.shape)[0, :FEW], many.directions[0, :FEW])
        generator = np.random.default_rng(0)
        scattered = generator.uniform(*self.mesh.bounds, (WIDTH * HEIGHT, 3)), generator.normal(size=(WIDTH * HEIGHT, 3))  # type: ignore[call-overload]
        return [few, many, Rays(*(values.astype(np.float32) for values in scattered))]

    def ask(self, scene: Any) -> None:
        """Closest hits with what is read of them, and occlusion."""
        for rays in self.batches():
            hits = scene.intersect(rays)
            hits.position, hits.normal  # noqa: B018 - computed when they are read
            scene.occluded(rays)


@dataclass(frozen=True)
class Feature:
    """A feature.

    Attributes:
        what: the calls that it compiles for, in words.
        call: makes them.
    """

    what: str
    call: Callable[[Samples], Any]


def _hits(samples: Samples) -> None:
    samples.ask(samples.scene)


def _kdtree(samples: Samples) -> None:
    samples.ask(samples.scene_of(samples.mesh, "kdtree"))


def _instances(samples: Samples) -> None:
    samples.ask(samples.forest)


def _all_hits(samples: Samples) -> None:
    for rays in samples.batches():
        samples.scene.intersect_all(rays)
        samples.scene.count(rays)


def _inside(samples: Samples) -> None:
    import numpy as np

    low, high = samples.mesh.bounds
    for count in (FEW, WIDTH * HEIGHT):
        samples.scene.contains(np.random.default_rng(0).uniform(low, high, (count, 3)).astype(np.float32))


def _visible(samples: Samples) -> None:
    import numpy as np

    points = np.random.default_rng(0).uniform(*samples.mesh.bounds, (100, 3))  # type: ignore[call-overload]
    samples.scene.visible(points[:, None], points)


def _spawn(samples: Samples) -> None:
    rays = samples.camera.rays()
    samples.scene.occluded(samples.scene.intersect(rays).spawn(-rays.directions), -rays.directions)


def _precise(samples: Samples) -> None:
    samples.scene.intersect(samples.camera.rays(), precise=True).position  # noqa: B018 - computed when it is read


def _update(samples: Samples) -> None:
    scene = samples.scene_of(samples.mesh)
    scene.update(0, vertices=samples.mesh.vertices * 1.01)
    samples.ask(scene)


def _ambient(samples: Samples) -> None:
    from wrt.imaging.integrators.rendering_call import render

    render(samples.scene, samples.camera, samples=1, ambient_samples=2)


def _integrator(name: str) -> Callable[[Samples], None]:
    def call(samples: Samples) -> None:
        from wrt.imaging.integrators.rendering_job import Rendering

        Rendering(samples.scene, samples.camera, integrator=name, samples=1).advance()

    return call


def _lidar(samples: Samples) -> None:
    import numpy as np

    from wrt.sensors.lidar import Lidar

    for scene in (samples.scene, samples.forest):
        Lidar.preset("velodyne_vlp16").scan(scene, np.eye(4)).to_structured()


def _camera(samples: Samples) -> None:
    import numpy as np

    from wrt.sensors.image_sensor import Camera
    from wrt.sensors.lens_models import BrownConrady

    matrix = np.array([[100.0, 0, WIDTH / 2], [0, 100.0, HEIGHT / 2], [0, 0, 1]])
    camera = Camera(WIDTH, HEIGHT, BrownConrady.from_matrix(matrix, np.zeros(5)))
    for scene in (samples.scene, samples.forest):
        camera.capture(scene, np.eye(4)).depth  # noqa: B018 - computed when it is read


def _gradients(samples: Samples) -> None:
    import warp as wp

    from wrt.query.gradients import differentiable_hits

    rays = samples.batches()[0]
    origins, directions = (wp.array(values, dtype=wp.vec3, device="cpu") for values in (rays.origins, rays.directions))
    hits = samples.scene.intersect(origins, directions)
    origins.requires_grad = True
    with wp.Tape() as tape:
        found = differentiable_hits(samples.scene, hits, origins, directions)
    tape.backward(grads={found.t: wp.ones_like(found.t)})


def _partitioned(samples: Samples) -> None:
    from wrt.disk.partitioned_scene import PartitionedScene

    with TemporaryDirectory(prefix="wrt-warm-") as folder:
        scene = PartitionedScene.build(samples.mesh, folder, part_triangles=4000, device="cpu")
        for rays in samples.batches():
            scene.intersect(rays)
            scene.occluded(rays)


FEATURES = {
    "hits": Feature("closest hits and occlusion of few and of many rays, positions, normals", _hits),
    "kdtree": Feature("the same in a kd-tree", _kdtree),
    "instances": Feature("the same in a scene of instances", _instances),
    "update": Feature("the same after an update of the vertices", _update),
    "all-hits": Feature("lists of all hits, and counts", _all_hits),
    "inside": Feature("`contains`", _inside),
    "visible": Feature("`visible`", _visible),
    "spawn": Feature("rays that start at hits", _spawn),
    "precise": Feature("closest hits in float64", _precise),
    "gradients": Feature("`differentiable_hits` of float32 rays, and back", _gradients),
    "partitioned": Feature("a scene in parts on disk", _partitioned),
    "picture": Feature("`render`: pictures by ambient occlusion", _ambient),
    "whitted": Feature("`Rendering` with mirrors and glass", _integrator("whitted")),
    "distribution": Feature("`Rendering` by distributed rays", _integrator("distribution")),
    "path": Feature("`Rendering` by path tracing", _integrator("path")),
    "lidar": Feature("scans of a lidar, of meshes and of instances", _lidar),
    "camera": Feature("images of a camera with a lens, of meshes and of instances", _camera),
}
"""All features by their names."""
