"""Browsers that leave at every stage, say nothing, too much or nonsense; and more of them than there are places."""

import logging
import socket
import threading
import time
from contextlib import ExitStack

import numpy as np
import pytest

import wrt
from wrt import scenes

pytest.importorskip("viser", reason="the viewer needs viser: pip install 'wrt[view]'")
import msgspec
from support.viewer_page import STAGES, Page, camera_fields, leave_at, left_over, until

from wrt.viewer import connections, live_view
from wrt.viewer.browser import LONGEST_SIDE, MAX_PIXELS, pose_of, size_of
from wrt.viewer.web_server import WebServer


@pytest.fixture(scope="module")
def viewer():
    scene = wrt.Scene(scenes.build("teapot", level=4), device="cpu")
    options = {"ambient": {"ambient_samples": 2}}
    camera = wrt.PinholeCamera(80, 60, **scenes.BUILTIN_SCENES["teapot"].camera)
    with wrt.view(scene, block=False, port=0, camera=camera, samples=2, options=options) as made:
        made._preparing.join(60.0)
        yield made


@pytest.fixture
def camera(viewer):
    return viewer._first_view[0]


@pytest.fixture
def page(viewer):
    """Makes pages, which leave at the end: page(**options)."""
    with ExitStack() as at_end:

        def make(**options):
            made = Page(viewer.url.replace("http", "ws"), **options)
            at_end.callback(made.close)
            return made

        yield make
    until(lambda: not left_over(viewer), 20.0)


@pytest.mark.parametrize("stage", range(len(STAGES)), ids=STAGES)
def test_leaving_at_every_stage(viewer, camera, stage):
    """Of 43 browsers that left while they connected, all 43 left a thread that rendered for ever; memory rose to 4.7 GB."""
    for _ in range(6 if stage < 5 else 3):
        leave_at(viewer, camera, stage)
    until(lambda: not left_over(viewer), 20.0)


def test_a_camera_that_is_read_after_the_end(viewer, camera, page):
    """viser reads the first camera in a task of its own, perhaps after it has told everybody that the browser has gone. It then
    kept the browser for ever, and told the viewer that one had come."""
    seen, called = [], viewer._server._client_connect_cb

    async def end_before(client):
        connections.Connection.current().end()  # what the end of the connection's handler does
        seen.append(client.client_id)

    called.insert(0, end_before)
    try:
        one = page()
        one.look(camera)
        until(lambda: seen and not viewer._server.get_clients())
        assert not viewer.sessions
        assert not viewer._web.browsers
    finally:
        called.remove(end_before)


def test_who_says_nothing_is_dismissed(viewer, page, monkeypatch):
    """A connection without a camera is no client; it was kept for as long as it liked."""
    monkeypatch.setattr(connections, "CAMERA_SECONDS", 0.2)
    silent = page()
    until(lambda: not silent.reader.is_alive(), 10.0)
    assert silent.socket.close_code == connections.TOO_LATE


def test_the_handshake_has_a_limit(monkeypatch):
    """Nobody holds a connection by sending a request letter by letter."""
    monkeypatch.setitem(connections.OPTIONS, "open_timeout", 0.3)
    server = WebServer("127.0.0.1", 0)
    with socket.create_connection(("127.0.0.1", server.port), timeout=10.0) as slow:
        begin = time.perf_counter()
        slow.sendall(b"GET / HTTP/1.1\r\n")
        assert slow.recv(1000) == b""
        assert time.perf_counter() - begin < 5.0
    server.close()


@pytest.mark.parametrize(
    ("what", "code"),
    [
        ("text", connections.UNREADABLE),
        (b"", connections.UNREADABLE),
        (b"\xc1 no messagepack", connections.UNREADABLE),
        (b"\x81\xa4type\xa4none", connections.UNREADABLE),  # a message of no kind
        (b"\x93\x01\x02\x03", connections.UNREADABLE),
        (msgspec.msgpack.encode({"type": "ViewerCameraMessage", "fov": "wide"}), connections.UNREADABLE),
        (bytes(connections.MESSAGE_BYTES + 1), 1009),
    ],
    ids=["text", "nothing", "noise", "no kind", "a list", "a word", "too long"],
)
def test_messages_that_cannot_be_read(viewer, camera, page, caplog, what, code):
    """They end the connection, with a reason, and the session; nothing is printed but one line. Others go on."""
    other, one = page(), page()
    for each in (other, one):
        each.look(camera)
        until(lambda each=each: each.pictures)
    with caplog.at_level(logging.INFO):
        one.socket.send(what)
        until(lambda: not one.reader.is_alive())
    assert one.socket.close_code == code
    until(lambda: len(viewer.sessions) == 1)
    assert "Traceback" not in caplog.text
    count = other.pictures
    other.look(camera, image_width=81)
    until(lambda: other.pictures > count)


NONSENSE = (
    {"position": (float("nan"), 0.0, 0.0)},
    {"position": (float("inf"), 0.0, 0.0)},
    {"look_at": (0.0, float("nan"), 0.0)},
    {"wxyz": (0.0, 0.0, 0.0, 0.0)},
    {"wxyz": (float("nan"),) * 4},
    {"wxyz": (1e300,) * 4},
    {"position": (1e308, 1e308, 1e308), "look_at": (-1e308, -1e308, -1e308)},
    {"fov": float("nan")},
    {"fov": 0.0},
    {"fov": -1.0},
    {"fov": 3.2},
    {"position": "here"},
    {"position": (1.0, 2.0)},
)


@pytest.mark.filterwarnings("ignore:.viser.*does not match annotation")
def test_cameras_that_make_no_sense(viewer, camera, page):
    """They are left out: what was wanted before stays, and the next camera that makes sense is followed."""
    one = page()
    one.look(camera)
    until(lambda: one.pictures and viewer.sessions)
    (session,) = viewer.sessions.values()
    until(lambda: session.is_idle)
    before = session.request.camera
    for fields in NONSENSE:
        one.look(camera, **fields)
    one.look(camera, image_width=90)
    until(lambda: session.request.size[0] == 90)
    assert session.request.camera == before
    assert session.error is None
    until(lambda: session.is_idle)


def test_a_first_camera_that_makes_no_sense(viewer, camera, page):
    one = page()
    one.look(camera, position=(float("nan"),) * 3, image_width=0, image_height=-5)
    until(lambda: one.pictures)
    (session,) = viewer.sessions.values()
    assert session.request.camera[0] == pytest.approx(tuple(camera.position))
    assert session.request.size == (1, 1)


class Window:
    """What a browser says of its window."""

    def __init__(self, width, height):
        self.image_width, self.image_height = width, height


@pytest.mark.parametrize("width", [0, -1, 1, 800, 100_000, 10**12, 1e300, float("inf"), float("nan"), None, "800", "wide"])
@pytest.mark.parametrize("height", [0, 1, 600, 10**9])
def test_sizes_of_windows(width, height):
    """From 1 pixel to 2.3 million: a window of 10^9 x 1 was believed."""
    got = size_of(Window(width, height))
    assert all(1 <= side <= LONGEST_SIDE for side in got)
    assert got[0] * got[1] <= MAX_PIXELS
    if (width, height) == (800, 600):
        assert got == (800, 600)


def test_a_pose_is_that_of_the_camera(camera):
    """The pose of what a page sends of a camera is that camera."""
    position, target, up, fov = pose_of(type("Sent", (), camera_fields(camera)))
    np.testing.assert_allclose(position, camera.position, atol=1e-6)
    forward = np.subtract(target, position)
    np.testing.assert_allclose(forward / np.linalg.norm(forward), camera.forward, atol=1e-6)
    assert fov == pytest.approx(camera.fov)
    assert np.dot(up, camera.up) > 0.0


def test_a_flood_of_cameras(viewer, camera, page):
    """A thousand in a second are one request: pictures are as many as the browser answers for, the last of the last camera."""
    one = page()
    one.look(camera)
    until(lambda: one.pictures)
    (session,) = viewer.sessions.values()
    until(lambda: session.is_idle)
    before = one.pictures
    for step in range(1000):
        one.look(camera, image_width=100 + step % 7, image_height=60 + step // 200)
    until(lambda: session.request.size == (100 + 999 % 7, 64) and session.is_idle)
    assert one.pictures - before < 200


def test_a_page_in_the_background(viewer, camera, page):
    """It does not answer for its picture, so it gets no other one, and costs nothing. It may stay."""
    one = page(answers=False)
    one.look(camera)
    until(lambda: one.pictures)
    time.sleep(0.3)
    for width in range(90, 100):
        one.look(camera, image_width=width)
    time.sleep(0.3)
    assert one.pictures == 1
    assert len(viewer.sessions) == 1


def test_whoever_waits_gets_the_next_place(viewer, camera, page, monkeypatch):
    """Over the limit, a page is told so, and shows the scene as soon as another leaves. Those that have left do not count."""
    monkeypatch.setattr(live_view, "MAX_CLIENTS", 2)
    for _ in range(5):
        leave_at(viewer, camera, 4)
    pages = [page() for _ in range(3)]
    for one in pages:
        one.look(camera)
        until(lambda one=one: one.pictures or one.texts)
    assert not pages[2].pictures
    assert "2 browsers look at this scene" in str(pages[2].texts)
    pages[0].close()
    until(lambda: pages[2].pictures)
    assert len(viewer.sessions) == 2
    until(lambda: pages[2].seen["RemoveNotificationMessage"])


def test_too_many_connections(viewer, camera, page, monkeypatch):
    """Whoever does not even look is bounded, too."""
    monkeypatch.setattr(connections, "MAX_CONNECTIONS", 2)
    first, second = page(), page()
    until(lambda: len(viewer._web._connections.open) == 2)
    third = page()
    until(lambda: not third.reader.is_alive())
    assert third.socket.close_code == connections.TRY_AGAIN
    first.close()
    until(lambda: len(viewer._web._connections.open) == 1)
    second.look(camera)
    until(lambda: second.pictures)


def test_the_scene_changes_while_it_is_shown(camera):
    """Updates and a tree that is built do not stop the pictures of those who look; the last picture is of the last scene."""
    mesh = scenes.build("teapot", level=4)
    scene, vertices = wrt.Scene(mesh, device="cpu"), np.array(mesh.vertices)
    options = {"ambient": {"ambient_samples": 2}}
    with wrt.view(scene, block=False, port=0, camera=camera, samples=1, options=options) as viewer:
        one = Page(viewer.url.replace("http", "ws"))
        one.look(camera)
        until(lambda: one.pictures)
        (session,) = viewer.sessions.values()
        until(lambda: session.is_idle)
        with viewer.shared._lock:  # as while a tree is built
            count = one.pictures
            one.look(camera, image_width=88)
            until(lambda: session.request.size[0] == 88 and session.is_idle and one.pictures > count, 20.0)
        for step in range(10):
            scene.update(0, vertices=np.add(vertices, (0.0, 0.0, 0.1 * step)))
            viewer.refresh()
            one.look(camera, image_width=80 + step)
        until(lambda: session.request.size[0] == 89 and session.is_idle)
        expected = wrt.render(scene, session.request.camera_of(), samples=1, ambient_samples=2)
        assert np.abs(session.picture.pixels() - 255.0 * expected).max() <= 1.0
        one.close()


def test_in_another_thread(camera):
    """`wrt.view` needs no main thread, and ends from another one than began it."""
    made, scene = [], wrt.Scene(scenes.build("teapot", level=4), device="cpu")
    options = {"ambient": {"ambient_samples": 2}}
    make = threading.Thread(target=lambda: made.append(wrt.view(scene, block=False, port=0, camera=camera, options=options)))
    make.start()
    make.join(60.0)
    (viewer,) = made
    one = Page(viewer.url.replace("http", "ws"))
    one.look(camera)
    until(lambda: one.pictures)
    waits = threading.Thread(target=viewer.wait)
    waits.start()
    viewer.close()
    waits.join(10.0)
    assert not waits.is_alive()
    assert not left_over(viewer)
    one.close()
