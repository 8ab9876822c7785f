"""The viewer in a real browser: Chromium without a screen, driven by Playwright; skipped where one of them is not to be had."""

import shutil
import time
from io import BytesIO

import numpy as np
import pytest
from PIL import Image

import wrt
from wrt import scenes
from wrt.imaging.image_files import to_bytes
from wrt.viewer.panels.scene_panel import GIZMO_PIXELS

pytest.importorskip("viser", reason="the viewer needs viser: pip install 'wrt[view]'")
playwright = pytest.importorskip("playwright.sync_api", reason="Playwright drives the browser: pip install playwright")
zstandard, msgspec = pytest.importorskip("zstandard"), pytest.importorskip("msgspec")

ARGUMENTS = ("--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--no-sandbox")
SIZE = {"width": 640, "height": 480}
PLACE = 90, 400
"""Of the window, where the picture is free of panels."""


def find_chromium():
    return next((path for name in ("chromium", "chromium-browser", "google-chrome") if (path := shutil.which(name))), None)


class Tab:
    """A page of the viewer, and the pictures that it has received."""

    def __init__(self, browser, viewer, size=SIZE):
        self.viewer, self.pictures = viewer, []
        known = set(viewer.sessions)
        self.page = browser.new_page(viewport=size)
        self.page.on("websocket", lambda socket: socket.on("framereceived", self._receive))
        self.page.goto(viewer.url)
        self.until(lambda: set(viewer.sessions) - known and self.pictures)
        (self.number,) = set(viewer.sessions) - known
        self.session = viewer.sessions[self.number]
        self.until(lambda: self.number in viewer.panels)  # they come with the first picture
        self.controls, self.pick, self.tree = viewer.panels[self.number]

    def _receive(self, data):
        if not isinstance(data, bytes):
            return
        length, packed = (int.from_bytes(data[begin : begin + 8], "little") for begin in (0, 8))
        unpacked = zstandard.ZstdDecompressor().decompress(data[16 : 16 + packed], max_output_size=length)
        for message in msgspec.msgpack.decode(unpacked)["messages"]:
            if message["type"] == "BackgroundImageMessage" and message["rgb_data"]:
                self.pictures.append(message["rgb_data"])

    def until(self, true, seconds=60.0):
        """Waits; the browser is served meanwhile. It counts its own waits: the process may be stopped for a while."""
        for _ in range(int(50 * seconds)):
            if true():
                return
            self.page.wait_for_timeout(20)
        assert true()

    def settle(self):
        """Waits until the whole picture is complete, and has arrived."""
        self.until(lambda: self.session.is_idle)
        count = len(self.pictures)
        self.page.wait_for_timeout(300)
        self.until(lambda: self.session.is_idle and len(self.pictures) >= count)

    def received(self):
        """(H, W, 3) the last picture."""
        return np.asarray(Image.open(BytesIO(self.pictures[-1])).convert("RGB")).astype(int)

    def close(self):
        self.page.close()


@pytest.fixture(scope="module")
def browser():
    path = find_chromium()
    if path is None:
        pytest.skip("no Chromium is installed: apt-get install chromium")
    with playwright.sync_playwright() as started:
        running = started.chromium.launch(executable_path=path, args=list(ARGUMENTS))
        yield running
        running.close()


@pytest.fixture(scope="module")
def viewer():
    view = scenes.BUILTIN_SCENES["teapot"].camera
    scene = wrt.Scene(scenes.build("teapot", level=4), device="cpu")
    options = {"ambient": {"ambient_samples": 2, "light": scenes.BUILTIN_SCENES["teapot"].light}}
    camera = wrt.PinholeCamera(640, 480, **view)
    with wrt.view(scene, block=False, port=0, camera=camera, samples=2, options=options) as made:
        yield made
    assert not made.sessions


@pytest.fixture(scope="module")
def tab(browser, viewer):
    made = Tab(browser, viewer)
    yield made
    made.close()


def test_picture_is_that_of_render(tab):
    """In the message, within the codec; and in the window, pixel by pixel."""
    view = scenes.BUILTIN_SCENES["teapot"].camera
    tab.until(lambda: np.allclose(tab.session.request.camera[0], view["position"], atol=1e-4))
    tab.settle()
    request = tab.session.request
    camera = request.camera_of()
    np.testing.assert_allclose(camera.forward, wrt.PinholeCamera(4, 3, **view).forward, atol=1e-5)
    assert camera.fov == pytest.approx(view["fov"], abs=1e-4)
    light = scenes.BUILTIN_SCENES["teapot"].light
    expected = to_bytes(wrt.render(tab.viewer.shared.scene, camera, samples=2, ambient_samples=2, light=light)).astype(int)
    np.testing.assert_array_equal(tab.session.picture.pixels(), expected)
    received = tab.received()
    assert received.shape == expected.shape
    assert np.abs(received - expected).mean() < 3.0
    shown = np.asarray(Image.open(BytesIO(tab.page.screenshot())).convert("RGB")).astype(int)
    free = np.s_[250:, :280]
    if shown.shape == received.shape:  # a browser without a GPU may show fewer pixels
        assert np.abs(shown[free] - received[free]).mean() < 6.0


def test_drag_moves_the_camera(tab):
    tab.settle()
    before, count = tab.session.request, len(tab.pictures)
    tab.page.mouse.move(*PLACE)
    tab.page.mouse.down()
    for step in range(6):
        tab.page.mouse.move(PLACE[0] + 10 * step, PLACE[1] + 3 * step)
    tab.page.mouse.up()
    tab.until(lambda: tab.session.request.camera != before.camera and len(tab.pictures) > count)
    tab.settle()
    after = tab.session.request.camera_of()
    old = before.camera_of()
    assert np.linalg.norm(after.position - old.position) > 0.1
    distances = [np.linalg.norm(camera.position - camera.look_at) for camera in (old, after)]
    assert distances[0] == pytest.approx(distances[1], rel=1e-3)  # it has turned around the same point
    expected = to_bytes(
        wrt.render(tab.viewer.shared.scene, after, samples=2, ambient_samples=2, light=scenes.BUILTIN_SCENES["teapot"].light)
    )
    assert np.abs(tab.received() - expected.astype(int)).mean() < 3.0


def test_looks(tab):
    for look in ("depth", "cost: nodes", "beauty"):
        tab.controls._look.value = look
        tab.until(lambda look=look: tab.session.request.look == look)
        tab.settle()
        np.testing.assert_array_less(np.abs(tab.received() - tab.session.picture.pixels().astype(int)).mean(), 4.0)
        has_scale = look != "beauty"
        assert tab.controls._scale.visible == has_scale
        assert ("inner nodes a ray" in tab.controls._scale.content) == (look == "cost: nodes") or look == "beauty"


def test_a_control_in_the_browser(tab):
    """The dropdown itself, as a hand would use it."""
    tab.settle()
    tab.page.locator("input:visible").first.click()
    tab.page.get_by_text("normals", exact=True).click()
    tab.until(lambda: tab.session.request.look == "normals")
    tab.controls._look.value = "beauty"
    tab.settle()


def test_bad_choices_are_reported_and_undone(tab):
    tab.controls._traversal.value = "mlrta"  # for kd-trees only
    tab.until(lambda: tab.controls._problem.visible)
    assert "mlrta" in tab.controls._problem.content
    tab.controls._traversal.value = "auto"
    tab.until(lambda: not tab.controls._problem.visible)
    tab.settle()


def test_pick_is_intersect(tab):
    """A click gives the hit of the ray through the pixel, and the way through the tree ends there."""
    tab.settle()
    tab.pick.hits = None
    tab.page.mouse.click(*PLACE)
    tab.until(lambda: tab.pick.hits is not None and "triangle" in tab.pick._text.content)
    camera = tab.session.request.camera_of()
    rays, size = camera.rays(), tab.session.request.size
    row, column = PLACE[1] * size[1] // SIZE["height"], PLACE[0] * size[0] // SIZE["width"]
    expected = tab.viewer.shared.scene.intersect(rays.origins.reshape(3), rays.directions[row, column])
    assert bool(tab.pick.hits.is_hit) == bool(expected.is_hit)
    assert float(tab.pick.hits.t) == pytest.approx(float(expected.t), rel=0.02)  # half a pixel beside its centre
    assert [visit.hit for visit in tab.pick.visits if visit.hit >= 0][-1] == int(tab.pick.hits.primitive_id)
    assert f"triangle {int(tab.pick.hits.primitive_id)}" in tab.pick._text.content


def test_tree_inspector(tab):
    tab.tree._shows.value = True
    tab.until(lambda: "level 2" in tab.tree._text.content)
    tab.tree._tree.value = "BVH and kd-tree side by side"
    tab.until(lambda: "kdtree" in tab.tree._text.content)
    assert tab.tree._text.content.count("boxes") == 2
    tab.tree._level.value = 1
    tab.until(lambda: "level 1" in tab.tree._text.content)
    tab.tree._shows.value = False
    tab.until(lambda: tab.tree._text.content == "")
    tab.tree.explain()
    assert "packet" in tab.tree._plan.content
    assert "SAH cost" in tab.tree._plan.content


def test_tree_and_threads_are_switched_while_it_runs(tab):
    tab.settle()
    panel, before = tab.viewer._panel, tab.received()
    panel._tree.value = "kdtree"
    tab.until(lambda: tab.viewer.shared.accelerator.kind == "kdtree")
    tab.settle()
    assert tab.viewer.shared.scene.accelerator.kind == "bvh"  # the caller's scene keeps its tree
    np.testing.assert_array_equal(tab.received(), before)  # one answer from every tree
    panel._threads.value = 1
    tab.until(lambda: tab.viewer.shared.threads == 1)
    tab.settle()
    np.testing.assert_array_equal(tab.received(), before)
    panel._tree.value = "as given"
    tab.until(lambda: tab.viewer.shared.accelerator.kind == "bvh")
    assert len(panel._builds) >= 2


def test_points_over_the_picture(tab):
    tab.settle()
    position = tab.session.request.camera_of().look_at
    tab.viewer.add_points(np.stack([position, position + 0.1]), [0.0, 1.0], size=20.0)
    tab.viewer.remove_points()
    with pytest.raises(ValueError, match="shape"):
        tab.viewer.add_points(np.zeros((3, 2)))


def test_idle_uses_no_cpu(tab):
    tab.settle()

    def used() -> float:
        """Seconds of the process in half a second: of the viewer's threads, and of kernels that other tests compile."""
        begin = time.process_time()
        time.sleep(0.5)
        return time.process_time() - begin

    assert any(used() < 0.05 for _ in range(100))
    assert max(used() for _ in range(3)) < 0.05


def test_clients_that_come_and_go(browser, viewer, tab):
    """Another client, which leaves in the middle of a picture: all that it held is freed."""
    other = Tab(browser, viewer)
    session = other.session
    assert len(viewer.sessions) == 2
    session.change(samples=256)  # work for minutes
    other.page.wait_for_timeout(400)
    assert not session.is_idle
    other.close()
    tab.until(lambda: len(viewer.sessions) == 1 and not session.is_alive)
    assert set(viewer.panels) == set(viewer.sessions)
    assert session.picture is None
    tab.settle()


def test_scene_that_moves(browser):
    """An animation plays, and updates elsewhere show after `refresh`."""
    mesh = scenes.build("teapot", level=4)
    scene, vertices = wrt.Scene(mesh, device="cpu"), np.array(mesh.vertices)

    def animate(scene, frame):
        scene.update(0, vertices=np.add(vertices, (0.1 * frame, 0.0, 0.0)))

    options = {"ambient": {"ambient_samples": 2}}
    with wrt.view(scene, block=False, port=0, options=options, samples=1, animate=animate, frames=4) as viewer:
        tab = Tab(browser, viewer)
        version = tab.session.request.version
        scene.update(0, vertices=np.add(vertices, (0.0, 0.0, 1.0)))
        viewer.refresh()
        tab.until(lambda: tab.session.request.version > version)
        viewer._panel._play.value = True
        tab.until(lambda: viewer.shared.is_playing and viewer.shared.frame == 3)
        viewer._panel._play.value = False
        tab.until(lambda: not viewer.shared.is_playing)
        tab.settle()
        expected = wrt.render(scene, tab.session.request.camera_of(), ambient_samples=2)
        assert np.abs(tab.received() - to_bytes(expected).astype(int)).mean() < 3.0
        tab.close()


def on_screen(camera, point):
    """Column and row of a point."""
    offset = np.asarray(point) - camera.position
    right = np.cross(camera.forward, camera.up)
    right /= np.linalg.norm(right)
    up = np.cross(right, camera.forward)
    scale = camera.height / 2 / np.tan(np.radians(camera.fov) / 2) / (offset @ camera.forward)
    return camera.width / 2 + scale * (offset @ right), camera.height / 2 - scale * (offset @ up)


def test_gizmo_moves_an_instance(browser):
    """The arrow of the gizmo is dragged: the instance moves along it, in the scene and in the picture; others rest.

    The address has a token.
    """
    mesh, matrix = scenes.build("teapot", level=4), np.eye(4)
    matrix[:3, 3] = -6.0, 0.0, 0.0
    scene = wrt.Scene([wrt.Instance(mesh), wrt.Instance(mesh, matrix)], device="cpu")
    camera = wrt.PinholeCamera(900, 600, fov=40.0, position=(0.0, -28.0, 6.0), look_at=(0.0, 0.0, 2.0), up=(0.0, 0.0, 1.0))
    options = {"ambient": {"ambient_samples": 2}}
    with wrt.view(scene, block=False, port=0, token=True, camera=camera, up=(0, 0, 1), samples=1, options=options) as viewer:
        assert viewer._web.gate.token in viewer.url
        tab = Tab(browser, viewer, {"width": 900, "height": 600})
        tab.settle()
        viewer._panel._instance.value = 1
        viewer._panel._moves.value = True
        tab.until(lambda: viewer._panel.gizmo is not None)
        tab.page.wait_for_timeout(500)  # until it is drawn
        seen = tab.session.request.camera_of()
        (column, row), (left, _) = on_screen(seen, matrix[:3, 3]), on_screen(seen, matrix[:3, 3] - (2.0, 0.0, 0.0))
        before = tab.received()
        arrow = column + 0.6 * GIZMO_PIXELS
        tab.page.mouse.move(arrow, row)
        tab.page.wait_for_timeout(200)
        tab.page.mouse.down()
        for step in range(1, 9):
            tab.page.mouse.move(arrow + step / 8 * (left - column), row)
            tab.page.wait_for_timeout(30)
        tab.page.mouse.up()
        tab.until(lambda: abs(scene.instances[1].transform[0, 3] + 8.0) < 0.3)
        tab.settle()
        np.testing.assert_allclose(scene.instances[1].transform[1:, 3], matrix[1:, 3], atol=1e-3)  # along the arrow only
        np.testing.assert_allclose(scene.instances[1].transform[:3, :3], np.eye(3), atol=1e-6)
        np.testing.assert_array_equal(scene.instances[0].transform, np.eye(4))
        assert tab.session.request.camera_of().position == pytest.approx(seen.position)  # the mouse moved no camera
        expected = to_bytes(wrt.render(scene, tab.session.request.camera_of(), ambient_samples=2)).astype(int)
        assert np.abs(tab.received() - expected).mean() < 3.0
        assert np.abs(tab.received() - before).mean() > 1.0
        assert "instance 1, updated in" in viewer._panel._moved_text.content
        tab.pick.pick(seen.position, scene.instances[1].transform[:3, 3] + (0.0, 0.0, 1.0) - seen.position)
        assert tab.pick.hits.instance_id == 1
        assert "instances " in tab.pick._text.content
        assert tab.pick.visits[-1].instance >= 0
        tab.tree._shows.value = True
        tab.until(lambda: "level" in tab.tree._text.content)  # the tree above the instances
        tab.close()
