"""Graph captures: kernels are recorded and do not run, so what needs their results at once is refused before anything happens.

A sensor's scan failed with an inner error of Warp; `visible`, the rays of cameras and casters, and trajectories gave the
contents of memory that nothing had been written to; an update built a tree of it.
"""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp
from support import call_objects

import wrt
from wrt.known_rays.ray_casters import CircularCapCaster

MESH = call_objects.mesh()


@pytest.fixture(scope="module")
def scene() -> wrt.Scene:
    return wrt.Scene(MESH, device="cpu")


def on_device(values: np.ndarray) -> wp.array:
    return wp.array(values, dtype=wp.vec3, device="cpu")


REFUSED = {
    "scan": lambda scene: call_objects.lidar().scan(scene, call_objects.pose()),
    "capture": lambda scene: call_objects.camera().capture(scene, call_objects.pose()),
    "render": lambda scene: wrt.render(scene, call_objects.pinhole()),
    "render paths": lambda scene: wrt.render(scene, call_objects.pinhole(), integrator="path", samples=1),
    "advance": lambda scene: call_objects.rendering().advance(),
    "contains": lambda scene: scene.contains(on_device(call_objects.rays()[0])),
    "visible": lambda scene: scene.visible(*map(on_device, call_objects.rays())),
    "intersect_all": lambda scene: scene.intersect_all(*map(on_device, call_objects.rays())),
    "verify": lambda scene: scene.verify(8),
    "update": lambda scene: scene.update(0, vertices=MESH.vertices + 1),
    "instances": lambda scene: call_objects.instances().update(0, mask=2),
    "add": lambda scene: call_objects.instances().add(wrt.Instance(MESH)),
    "remove": lambda scene: call_objects.instances().remove(0),
    "Scene": lambda scene: wrt.Scene(MESH, device="cpu"),
    "instances made": lambda scene: wrt.Scene([wrt.Instance(MESH)], device="cpu"),
    "show": lambda scene: call_objects.fuzzy().show(1),
    "LightBuffer": lambda scene: wrt.lights.LightBuffer(scene, (0, 0, 9)),
    "rays of a camera": lambda scene: call_objects.pinhole().rays(),
    "rays of a caster": lambda scene: CircularCapCaster(**call_objects.AIM, angle=20).rays(4),
    "trajectory": lambda scene: call_objects.trajectory().at([0.5]),
    "deskew": lambda scene: wrt.sensors.deskew(np.zeros((1, 3)), [0.0], call_objects.trajectory(), 0.0),
    "project": lambda scene: call_objects.camera().lens.project([0, 0, 1]),
    "affine": lambda scene: call_objects.area().affine(*call_objects.rays()),
    "attribute": lambda scene: call_objects.hits().position,
    "parts": lambda scene: call_objects.parts().occluded(*map(on_device, call_objects.rays())),
}


@pytest.mark.parametrize("call", REFUSED)
def test_what_needs_results_at_once_is_refused(scene, call):
    for known in (
        "lidar",
        "camera",
        "pinhole",
        "pose",
        "rendering",
        "rays",
        "instances",
        "fuzzy",
        "trajectory",
        "area",
        "parts",
    ):
        getattr(call_objects, known)()
    call_objects.hits().__dict__.pop("position", None)
    before, bounds = call_objects.fuzzy().frame, scene.bounds
    with wp.ScopedCapture(device="cpu"), pytest.raises(RuntimeError, match=r"part of a graph.*before or after the capture"):
        REFUSED[call](scene)
    assert call_objects.fuzzy().frame == before
    assert len(call_objects.instances().instances) == 2
    np.testing.assert_array_equal(scene.bounds, bounds)


def test_queries_in_warp_arrays_are_recorded(scene):
    """Each launch of the graph answers the rays as they are then."""
    origins, directions = map(on_device, call_objects.rays())
    queries = {
        "t": lambda: scene.intersect(origins, directions).t,
        "precise": lambda: scene.intersect(origins, directions, precise=True).t,
        "occluded": lambda: scene.occluded(origins, directions),
        "count": lambda: scene.count(origins, directions),
        "position": lambda: scene.intersect(origins, directions).position,
    }
    expected = {name: query().numpy() for name, query in queries.items()}
    with wp.ScopedCapture(device="cpu") as capture:
        found = {name: query() for name, query in queries.items()}
    wp.capture_launch(capture.graph)
    for name, values in expected.items():
        np.testing.assert_array_equal(found[name].numpy(), values)
