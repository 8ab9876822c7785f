"""Many clients at once, and clients through a tunnel: websocket clients that speak as viser's page does, without a browser."""

import socket
import threading
import time
from contextlib import ExitStack

import numpy as np
import pytest

import wrt
from wrt import scenes

pytest.importorskip("viser", reason="the viewer needs viser: pip install 'wrt[view]'")
from support.viewer_page import Page, until

CLIENTS = 8


@pytest.fixture(scope="module")
def viewer():
    scene = wrt.Scene(scenes.build("teapot", level=4), device="cpu")
    options = {"ambient": {"ambient_samples": 2}}
    camera = wrt.PinholeCamera(80, 60, **scenes.BUILTIN_SCENES["teapot"].camera)
    with wrt.view(scene, block=False, port=0, camera=camera, samples=2, options=options) as made:
        yield made


def view_from(camera, turn):
    """The camera turned around what it looks at."""
    x, y, z = camera.position - camera.look_at
    c, s = np.cos(turn), np.sin(turn)
    at = np.add(camera.look_at, (c * x - s * y, s * x + c * y, z))
    return wrt.PinholeCamera(80, 60, fov=camera.fov, position=at, look_at=camera.look_at, up=camera.up)


def test_eight_clients_at_once(viewer):
    """All get pictures while all of them move; then they leave, some in the middle of a picture, and nothing stays."""
    camera, address = viewer._first_view[0], viewer.url.replace("http", "ws")
    with ExitStack() as at_end:
        pages = [Page(address) for _ in range(CLIENTS)]
        for page in pages:
            at_end.callback(page.close)
            page.look(camera)
        until(lambda: len(viewer.sessions) == CLIENTS and len(viewer.panels) == CLIENTS)
        for step in range(10):
            for number, page in enumerate(pages):
                page.look(view_from(camera, 0.05 * step + number))
            time.sleep(0.03)
        sessions = [*viewer.sessions.values()]
        until(lambda: all(session.is_idle for session in sessions) and all(page.pictures >= 3 for page in pages))
        assert len({session.request.camera for session in sessions}) == CLIENTS
        for session in sessions[::2]:
            session.change(samples=256)
        time.sleep(0.1)
    until(lambda: not viewer.sessions and not viewer.panels)
    until(lambda: not any(session.is_alive for session in sessions))
    assert all(session.picture is None for session in sessions)
    until(lambda: not any(thread.name in ("wrt-frames", "wrt-panels") for thread in threading.enumerate()))


def test_seventeenth_client_gets_no_picture(viewer):
    """Memory and work of all clients together are bounded."""
    camera, address = viewer._first_view[0], viewer.url.replace("http", "ws")
    with ExitStack() as at_end:
        pages = [Page(address) for _ in range(17)]
        for page in pages:
            at_end.callback(page.close)
            page.look(camera)
        until(lambda: sum(page.pictures > 0 for page in pages) == 16)
        assert len(viewer.sessions) == 16
    until(lambda: not viewer.sessions)


def test_through_a_tunnel(viewer):
    """As by `ssh -L`: another port of this computer leads to the viewer's."""
    with socket.create_server(("127.0.0.1", 0)) as listener:
        threading.Thread(target=forward, args=(listener, viewer._web.port), daemon=True).start()
        page = Page(f"ws://localhost:{listener.getsockname()[1]}")
        page.look(viewer._first_view[0])
        until(lambda: page.pictures >= 2)
        page.close()
    until(lambda: not viewer.sessions)


def forward(listener, port):
    """Copies bytes of the first connection to a port, and back."""
    near, _ = listener.accept()
    far = socket.create_connection(("127.0.0.1", port))

    def copy(source, target):
        while data := source.recv(1 << 16):
            target.sendall(data)
        target.shutdown(socket.SHUT_WR)

    threading.Thread(target=copy, args=(far, near), daemon=True).start()
    copy(near, far)
