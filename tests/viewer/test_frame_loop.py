"""The loop that makes a client's pictures, without a browser, a server or a scene."""

import threading
import time

import pytest

from wrt.viewer import frame_loop
from wrt.viewer.frame_loop import SCALES, FrameLoop


class Sketch:
    """A picture of so many samples, each of which takes `steps` checks."""

    def __init__(self, request, scale, is_coarse, samples=3, steps=1, pause=0.0):
        self.request, self.scale, self.is_coarse = request, scale, is_coarse
        self.samples, self.steps, self.pause = 1 if is_coarse else samples, steps, pause
        self.done = self.rays = 0

    @property
    def is_complete(self):
        return self.done >= self.samples

    def advance(self, check):
        for _ in range(self.steps):
            time.sleep(self.pause)
            check()
        self.done += 1
        self.rays += 10

    def pixels(self):
        return self


class Client:
    """Records what is shown; `gate` is open while the client takes pictures."""

    def __init__(self, make=Sketch):
        self.shown, self.errors, self.gate = [], [], threading.Event()
        self.gate.set()
        self.loop = FrameLoop(make, self.show, self.errors.append)

    def show(self, pixels, times):
        self.gate.wait(10)
        self.shown.append((pixels, times))

    def wait(self, until, seconds=10.0):
        end = time.perf_counter() + seconds
        while not until() and time.perf_counter() < end:
            time.sleep(0.005)
        assert until()


@pytest.fixture
def client():
    made = Client()
    made.loop.start()
    yield made
    made.gate.set()
    made.loop.close()
    assert not made.loop.is_alive


def test_coarse_then_whole_then_complete(client):
    client.loop.want("a")
    client.wait(lambda: client.loop.is_idle)
    times = [one for _, one in client.shown]
    assert times[0].is_coarse
    assert times[0].scale < 1.0
    assert not times[1].is_coarse
    assert times[1].scale == 1.0
    assert times[-1].is_complete
    assert client.shown[-1][0].done == 3


def test_sleeps_when_all_is_shown(client):
    client.loop.want("a")
    client.wait(lambda: client.loop.is_idle)
    count, used = len(client.shown), time.process_time()
    client.loop.want("a")  # what is shown already
    time.sleep(0.4)
    assert len(client.shown) == count
    assert time.process_time() - used < 0.2


def test_a_new_request_ends_the_whole_picture():
    """A picture of a second must not stand between the mouse and the next picture."""
    client = Client(lambda request, scale, coarse: Sketch(request, scale, coarse, steps=1 if coarse else 200, pause=0.005))
    client.loop.start()
    client.loop.want("a")
    client.wait(lambda: client.shown)
    time.sleep(frame_loop.SETTLE + 0.1)  # the whole picture of "a" is under way
    client.loop.want("b")
    client.wait(lambda: client.shown[-1][0].request == "b", 0.5)
    assert all(picture.is_coarse for picture, _ in client.shown)
    client.loop.close()
    assert not client.loop.is_alive


def test_pictures_never_queue_up(client):
    """A client that takes no pictures while the camera moves gets the newest one afterwards, not all of them."""
    client.gate.clear()
    for request in range(50):
        client.loop.want(request)
        time.sleep(0.004)
    client.gate.set()
    client.wait(lambda: client.loop.is_idle)
    requests = [picture.request for picture, _ in client.shown]
    assert len(set(requests)) <= 4
    assert requests[-1] == 49


def test_an_error_is_reported_and_the_next_request_is_served():
    def make(request, scale, is_coarse):
        if request == "bad":
            raise ValueError("no such tree")
        return Sketch(request, scale, is_coarse)

    client = Client(make)
    client.loop.start()
    client.loop.want("bad")
    client.wait(lambda: client.errors)
    assert client.loop.is_idle
    client.loop.want("good")
    client.wait(lambda: client.loop.is_idle)
    assert client.shown[-1][0].request == "good"
    assert len(client.errors) == 1
    client.loop.close()


def test_scale_follows_the_time_of_pictures(monkeypatch):
    """Pictures whose time grows with their area come out near the budget; a single slow one changes nothing."""
    loop = FrameLoop(Sketch, lambda *_: None, lambda error: None)

    def settle(seconds_of_whole, pictures=60):
        for _ in range(pictures):
            loop._adapt(seconds_of_whole * SCALES[loop._scale] ** 2)
        return SCALES[loop._scale]

    assert settle(0.001) == 1.0
    loop._adapt(1.0)
    assert SCALES[loop._scale] == 1.0
    coarse = settle(0.4)
    assert coarse in (0.25, 0.35)
    assert settle(10.0) == SCALES[-1]
    assert settle(0.001, 200) == 1.0


def test_closing_in_the_middle_of_a_picture():
    client = Client(lambda request, scale, coarse: Sketch(request, scale, coarse, steps=1 if coarse else 1000, pause=0.005))
    client.loop.start()
    client.loop.want("a")
    client.wait(lambda: client.shown)
    time.sleep(frame_loop.SETTLE + 0.1)
    start = time.perf_counter()
    client.loop.close()
    assert not client.loop.is_alive
    assert time.perf_counter() - start < 1.0
