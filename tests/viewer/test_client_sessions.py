"""The life of sessions, without a browser: whoever leaves, at whatever moment, leaves nothing behind."""

import itertools
import threading
import time

import numpy as np
import pytest

from wrt.viewer import client_session
from wrt.viewer.client_session import ClientSession
from wrt.viewer.connections import Connection
from wrt.viewer.pictures.view_request import ViewRequest
from wrt.viewer.session_life import NEXT, Life, SessionState

POSE = (0.0, -3.0, 1.0), (0.0, 0.0, 0.0), (0.0, 0.0, 1.0), 40.0
THREADS = "wrt-frames", "wrt-panels"


class FakeBrowser:
    """A browser that answers for pictures if it is told to."""

    numbers = itertools.count()

    def __init__(self, answers=True):
        self.client, self.number, self.answers = None, next(self.numbers), answers
        self.connection = Connection()
        self.look, self.shown, self.told = None, threading.Event(), []

    @property
    def is_connected(self):
        return self.connection.is_open

    def at_end(self, action):
        self.connection.at_end(action)

    def view(self):
        return POSE, (8, 6)

    def on_look(self, look):
        self.look = look

    def show(self, pixels, is_coarse, received):
        self.shown.set()
        if self.answers:
            received()

    def notify(self, title, text):
        self.told.append(text)
        return lambda: self.told.remove(text)


class FakeScene:
    """A scene that never changes."""

    threads = None
    current = 1, None

    def __init__(self):
        self.listeners = []

    def listen(self, listener):
        self.listeners.append(listener)

    def forget(self, listener):
        if listener in self.listeners:
            self.listeners.remove(listener)


class Sketch:
    """A picture of 3 samples, or of work for minutes that looks whether it is still wanted."""

    scale, rays = None, 1

    def __init__(self, is_coarse, is_long):
        self.left = 1 if is_coarse else (100_000 if is_long else 3)

    @property
    def is_complete(self):
        return self.left == 0

    def advance(self, check):
        time.sleep(0.001)
        check()
        self.left -= 1

    def pixels(self):
        return np.zeros((6, 8, 3), np.uint8)


@pytest.fixture
def shared(monkeypatch):
    def make(scene, request, scale, is_coarse, options):
        return Sketch(is_coarse, request.samples > 4)

    monkeypatch.setattr(client_session, "make_picture", make)
    monkeypatch.setattr("wrt.viewer.frame_loop.SETTLE", 0.002)
    return FakeScene()


def session_of(shared, browser, samples=4, **options):
    return ClientSession(browser, shared, ViewRequest(0, POSE, (8, 6), samples=samples), {}, **options)


def until(true, seconds=10.0):
    end = time.perf_counter() + seconds
    while not true() and time.perf_counter() < end:
        time.sleep(0.001)
    assert true()


def own_threads():
    return [thread for thread in threading.enumerate() if thread.name in THREADS]


def test_states_follow_one_another():
    """From every state, only those that the table names; and no way leads back."""
    for here, before, after in itertools.product(SessionState, repeat=3):
        life = Life()
        life._state = here
        if after not in NEXT[before]:
            with pytest.raises(ValueError, match=f"from {before.value} to {after.value}"):
                life.move(before, after)
        else:
            assert life.move(before, after) == (here is before)
        assert life.state is (after if here is before and after in NEXT[before] else here)
    assert NEXT[SessionState.LEFT] == ()
    assert all(state not in NEXT[later] for state, laters in NEXT.items() for later in laters)


def test_one_of_many_threads_moves():
    life, won = Life(), []
    go = SessionState.ARRIVED, SessionState.WATCHING
    threads = [threading.Thread(target=lambda: won.append(life.move(*go))) for _ in range(16)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sum(won) == 1


def test_hundreds_of_clients_leave_at_any_moment(shared):
    """A browser that left while it connected left a thread that made pictures for ever: the session was marked as closed by the
    thread itself, and `close` then did nothing."""
    left, moments = [], itertools.cycle(range(6))
    for _ in range(300):
        moment = next(moments)
        browser = FakeBrowser(answers=moment != 3)
        session = session_of(shared, browser, samples=256 if moment == 4 else 4, left=left.append)
        if moment > 0:  # 0: it leaves before anything has begun
            session.start()
        if moment == 2:  # with its first picture under way
            time.sleep(0.0005)
        if moment >= 3:  # 3: it never answers for its picture; 4: in the middle of work for minutes
            assert browser.shown.wait(10.0)
        if moment == 3:
            time.sleep(0.02)  # until the next picture waits for the answer
        if moment == 5:
            until(lambda session=session: session.is_idle)
        if moment == 2:
            threading.Thread(target=session.leave).start()
        session.leave()
        session.leave()
        assert session.close(10.0)
        assert session.life.state is SessionState.LEFT
        assert session.picture is None
    assert len(left) == len(set(left)) == 300
    assert not shared.listeners
    assert not own_threads()


def test_a_session_that_left_does_not_start(shared):
    session = session_of(shared, FakeBrowser())
    session.leave()
    session.start()
    assert session.life.state is SessionState.LEFT
    assert not session.is_alive
    assert not shared.listeners


def test_no_more_threads(shared, monkeypatch):
    """The system may refuse a thread: the session is over then, and nothing of it stays."""
    session = session_of(shared, FakeBrowser())

    def refuse():
        raise RuntimeError("can't start new thread")

    monkeypatch.setattr(session._loop, "start", refuse)
    with pytest.raises(RuntimeError, match="new thread"):
        session.start()
    assert session.life.state is SessionState.LEFT
    assert not shared.listeners
    until(lambda: not own_threads())


def test_an_error_of_a_picture_is_told_and_another_request_mends_it(shared, monkeypatch):
    """Not a black page: the panel says what is wrong, and the session goes on."""
    browser, errors = FakeBrowser(), []
    session = session_of(shared, browser)
    make = client_session.make_picture

    def fail(scene, request, *rest):
        if request.look == "depth":
            raise ValueError("no such tree")
        return make(scene, request, *rest)

    monkeypatch.setattr(client_session, "make_picture", fail)
    session.on_error = errors.append
    session.start()
    until(lambda: session.is_idle)
    session.change(look="depth")
    until(lambda: session.error is not None)
    assert str(errors[-1]) == "no such tree"
    assert session.life.state is SessionState.WATCHING
    session.change(look="beauty")
    until(lambda: session.is_idle and session.error is None)
    assert session.close()


@pytest.mark.parametrize("where", ["report", "panels"])
def test_an_error_that_nobody_foresaw_ends_the_session(shared, monkeypatch, where):
    """An error of the code that reports errors, or of the panels: the user is told, nothing runs on, and the place is free."""

    def fail(*_):
        raise OSError("broken")

    browser, left = FakeBrowser(), []
    session = session_of(shared, browser, left=left.append, **({"furnish": fail} if where == "panels" else {}))
    if where == "report":
        monkeypatch.setattr(client_session, "make_picture", fail)
        session.on_error = fail
    session.start()
    assert session.life.wait(SessionState.LEFT, 10.0)
    assert "OSError: broken" in browser.told[0]
    assert "Load the page again" in browser.told[0]
    assert isinstance(session.error, OSError)
    until(lambda: left == [session] and not own_threads())


def test_a_thousand_cameras_a_second(shared):
    """Only the newest one counts: no queue of pictures grows."""
    browser = FakeBrowser()
    session = session_of(shared, browser)
    session.start()
    for step in range(1000):
        browser.look((POSE[0], (0.0, 0.0, 1e-3 * step), *POSE[2:]), (8, 6))
    until(lambda: session.is_idle)
    assert session.request.camera[1][2] == pytest.approx(0.999)
    assert session.close()


@pytest.mark.parametrize("moves", [True, False])
def test_a_page_that_loads_shows_the_first_view(shared, monkeypatch, moves):
    """It tells of a camera of its own before it takes the first view. One that has its view already tells of it once."""
    monkeypatch.setattr(client_session, "SETTLED_AFTER", 0.2)
    browser, elsewhere, seen = FakeBrowser(), ((9.0, 9.0, 9.0), (0.0, 0.0, 0.0), *POSE[2:]), []
    browser.view = lambda: (elsewhere, (8, 6))
    session = session_of(shared, browser)
    made = client_session.make_picture
    monkeypatch.setattr(client_session, "make_picture", lambda *given: (seen.append(given[1].camera), made(*given))[1])
    session.start()
    until(lambda: session.is_idle and seen)
    assert {*seen} == {POSE}
    if moves:
        browser.look(POSE, (8, 6))
        time.sleep(0.4)
    else:
        until(lambda: elsewhere in seen)
    assert session.request.camera == (POSE if moves else elsewhere)
    assert session.close()


def test_closing_from_the_threads_of_the_session(shared):
    """Whoever calls `close` from a callback does not wait for himself."""
    browser, took = FakeBrowser(), []
    session = session_of(shared, browser)

    def close(times):
        begin = time.perf_counter()
        session.close(5.0)
        took.append(time.perf_counter() - begin)

    session.on_shown = close
    session.start()
    assert session.life.wait(SessionState.LEFT, 10.0)
    assert took[0] < 1.0
