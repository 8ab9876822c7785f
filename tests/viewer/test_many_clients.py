"""Many clients at once, and clients through a tunnel: websocket clients that speak as viser's page does, without a browser."""

import socket
import threading
import time
from contextlib import ExitStack

import numpy as np
import pytest

import wrt
from wrt import scenes

viser = pytest.importorskip("viser", reason="the viewer needs viser: pip install 'wrt[view]'")
client = pytest.importorskip("websockets.sync.client")
zstandard, msgspec = pytest.importorskip("zstandard"), pytest.importorskip("msgspec")

CLIENTS = 8


class Page:
    """A client that moves its camera, counts the pictures that come, and answers for each as a browser does."""

    def __init__(self, address):
        protocol = f"viser-v{viser.__version__}"
        self.socket = client.connect(address, subprotocols=[protocol], max_size=None, origin=address.replace("ws", "http"))
        self.pictures = 0
        self.reader = threading.Thread(target=self._read, daemon=True)
        self.reader.start()

    def _read(self):
        try:
            for data in self.socket:
                length, packed = (int.from_bytes(data[begin : begin + 8], "little") for begin in (0, 8))
                inner = zstandard.ZstdDecompressor().decompress(data[16 : 16 + packed], max_output_size=length)
                for message in msgspec.msgpack.decode(inner)["messages"]:
                    self.pictures += message["type"] == "BackgroundImageMessage" and message["rgb_data"] is not None
                    if message["type"] == "LocalStorageGetItemRequestMessage":
                        answer = {"value": None, "error": None, "request_uuid": message["request_uuid"]}
                        self._send("LocalStorageGetItemResponseMessage", answer)
        except Exception:  # the test closes the socket
            return

    def _send(self, kind, fields):
        self.socket.send(msgspec.msgpack.encode({"type": kind, **fields}))

    def look(self, camera):
        """Sends a camera."""
        right = np.cross(camera.forward, camera.up)
        right /= np.linalg.norm(right)
        axes = np.stack([right, np.cross(camera.forward, right), camera.forward], axis=1)
        pose = {
            "wxyz": tuple(map(float, viser.transforms.SO3.from_matrix(axes).wxyz)),
            "position": tuple(map(float, camera.position)),
            "look_at": tuple(map(float, camera.look_at)),
            "up_direction": tuple(map(float, camera.up)),
        }
        lens = {"fov": float(np.radians(camera.fov)), "near": 0.01, "far": 1e3, "image_height": 60, "image_width": 80}
        self._send("ViewerCameraMessage", pose | lens)

    def close(self):
        self.socket.close()
        self.reader.join(10.0)


@pytest.fixture(scope="module")
def viewer():
    scene = wrt.Scene(scenes.build("teapot", level=4), device="cpu")
    options = {"ambient": {"ambient_samples": 2}}
    camera = wrt.PinholeCamera(80, 60, **scenes.BUILTIN_SCENES["teapot"].camera)
    with wrt.view(scene, block=False, port=0, camera=camera, samples=2, options=options) as made:
        yield made


def until(true, seconds=60.0):
    end = time.perf_counter() + seconds
    while not true() and time.perf_counter() < end:
        time.sleep(0.01)
    assert true()


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
        assert len({session.wish.camera for session in sessions}) == CLIENTS
        for session in sessions[::2]:
            session.change(samples=256)
        time.sleep(0.1)
    until(lambda: not viewer.sessions and not viewer.panels)
    until(lambda: not any(session.is_alive for session in sessions))
    assert all(session.picture is None for session in sessions)
    until(lambda: not any(thread.name.startswith("wrt-received") for thread in threading.enumerate()))


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
