"""Who may speak to a viewer: tokens, and pages of other sites. No browser; a websocket client asks."""

import errno
import socket
import warnings
from http.client import HTTPConnection
from urllib.error import HTTPError
from urllib.request import urlopen

import pytest

import wrt
from wrt import scenes

viser = pytest.importorskip("viser", reason="the viewer needs viser: pip install 'wrt[view]'")
client = pytest.importorskip("websockets.sync.client")
from websockets.exceptions import InvalidStatus  # noqa: E402 (comes with viser)

from wrt.viewer import web_server  # noqa: E402
from wrt.viewer.addresses import Gate  # noqa: E402
from wrt.viewer.web_server import WebServer  # noqa: E402

TOKEN = "known-to-few_7"


@pytest.fixture(scope="module")
def mesh():
    return scenes.build("teapot", level=4)


def connected(address, **options):
    """A client that speaks as viser's page does."""
    return client.connect(address, subprotocols=[f"viser-v{viser.__version__}"], max_size=None, **options)


def refused(address, **options):
    with pytest.raises(InvalidStatus) as error, connected(address, **options):
        pass
    return error.value.response.status_code


@pytest.mark.parametrize(
    ("token", "only_here", "path", "headers", "expected"),
    [
        (TOKEN, False, f"/{TOKEN}", {}, "/"),
        (TOKEN, False, f"/{TOKEN}/", {}, "/"),
        (TOKEN, False, f"/{TOKEN}/assets/a.js?x=1", {}, "/assets/a.js"),
        (TOKEN, False, f"/{TOKEN}", {"Host": "a:1", "Origin": "https://b"}, "/"),  # through another server
        (TOKEN, False, "/", {}, None),
        (TOKEN, False, f"/{TOKEN}x/", {}, None),
        (TOKEN, False, f"//{TOKEN}/", {}, None),
        (TOKEN, True, f"/?{TOKEN}", {}, None),
        (TOKEN, True, "/\xe9", {}, None),
        (None, True, "/", {"Host": "localhost:8080"}, "/"),
        (None, True, "/", {"Host": "[::1]:8080", "Origin": "http://[::1]:8080"}, "/"),
        (None, True, "/", {"Host": "127.0.0.1:8080", "Origin": "http://127.0.0.1:8080"}, "/"),
        (None, True, "/", {"Host": "127.0.0.1:8080", "Origin": "https://elsewhere.org"}, None),
        (None, True, "/", {"Host": "elsewhere.org:8080", "Origin": "http://elsewhere.org:8080"}, None),  # a name for 127.0.0.1
        (None, False, "/", {"Host": "here.org:8080", "Origin": "http://here.org:8080"}, "/"),
        (None, False, "/", {"Host": "here.org:8080", "Origin": "http://elsewhere.org"}, None),
        (
            None,
            False,
            "/",
            {"Host": "elsewhere.org:8080", "Origin": "http://elsewhere.org:8080"},
            None,
        ),  # by DNS
    ],
)
def test_gate(token, only_here, path, headers, expected):
    host = "127.0.0.1" if only_here else "here.org"
    assert Gate(token, only_here, host).admit(path, headers) == expected


def test_no_picture_without_the_token(mesh):
    """Refused before a connection is made: no message comes, none is read, and no client is counted."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # none, as there is a token
        viewer = wrt.view(mesh, block=False, host="0.0.0.0", port=0)
    with viewer:
        address, token = f"127.0.0.1:{viewer._web.port}", viewer._web.gate.token
        assert len(token) >= 20
        assert viewer.url == f"http://localhost:{viewer._web.port}/{token}/"
        for path in ("", "/", f"/{token[:-1]}", f"/?{token}"):
            assert refused(f"ws://{address}{path}") == 403
            with pytest.raises(HTTPError, match="403"):
                urlopen(f"http://{address}{path or '/'}")
        assert not viewer._server._websock_server._client_state_from_id
        assert b"Viser" in urlopen(f"http://{address}/{token}/").read()
        with connected(f"ws://{address}/{token}") as admitted:
            assert len(admitted.recv(timeout=20.0)) > 16
    assert viewer._ended.is_set()


def test_every_viewer_has_another_token():
    with_tokens = [WebServer("127.0.0.1", 0, True) for _ in range(2)]
    assert with_tokens[0].gate.token != with_tokens[1].gate.token
    for server in with_tokens:
        server.close()


def test_warns_if_everybody_can_reach_it(mesh):
    with pytest.warns(UserWarning, match="without a password"):
        viewer = wrt.view(mesh, block=False, host="0.0.0.0", port=0, token=False)
    with viewer:
        assert viewer.url == f"http://localhost:{viewer._web.port}"
        with connected(f"ws://127.0.0.1:{viewer._web.port}") as admitted:
            assert admitted.recv(timeout=20.0)
    viewer.close()


def test_pages_of_other_sites_are_refused():
    """A page that the user reads could else speak to the viewer on this computer."""
    server = WebServer("127.0.0.1", 0)
    address = f"ws://127.0.0.1:{server.port}"
    assert refused(address, origin="https://elsewhere.org") == 403
    with connected(address, origin=f"http://127.0.0.1:{server.port}") as admitted:
        assert admitted.recv(timeout=20.0)
    server.close()


def test_a_viser_that_lets_everybody_in_is_noticed(monkeypatch):
    """If viser listens in another way, nothing stays open."""
    monkeypatch.setattr(web_server, "_around", lambda answer, gate: answer)
    with pytest.raises(RuntimeError, match="lets everybody in"):
        WebServer("0.0.0.0", 0)


def test_a_name_for_this_computer_does_not_open_it():
    """A page of 127.evil.com, whose name leads to 127.0.0.1 by now, was answered 101: its name began with "127."."""
    server = WebServer("127.0.0.1", 0)
    address = f"ws://127.0.0.1:{server.port}"
    for name in ("127.evil.com", "localhost.evil.com", "127.0.0.1.evil.com", "2130706433", "127.1", "0x7f.1"):
        headers = {"Host": f"{name}:{server.port}"}
        assert handshake(server.port, {**headers, "Origin": f"http://{name}:{server.port}"}) == 403
        assert handshake(server.port, headers) == 403
    assert handshake(server.port, {}) == 403
    assert handshake(server.port, {"Host": [f"localhost:{server.port}", "127.evil.com"]}) == 403
    assert handshake(server.port, {"Host": f"LocalHost:{server.port}", "Origin": f"http://localhost:{server.port}"}) == 101
    with connected(address) as admitted:
        assert admitted.recv(timeout=20.0)
    server.close()


def handshake(port, headers):
    """The status of the answer to a request for a websocket; a list sends a header several times."""
    asks = {
        "Upgrade": "websocket",
        "Connection": "Upgrade",
        "Sec-WebSocket-Version": "13",
        "Sec-WebSocket-Key": "A" * 22 + "==",
    }
    connection = HTTPConnection("127.0.0.1", port, timeout=20.0)
    connection.putrequest("GET", "/", skip_host=True)
    for name, values in {**asks, **headers}.items():
        for value in values if isinstance(values, list) else [values]:
            connection.putheader(name, value)
    connection.endheaders()
    status = connection.getresponse().status
    connection.close()
    return status


def test_addresses():
    for host, expected in (("127.0.0.1", "http://127.0.0.1:"), ("localhost", "http://localhost:")):
        server = WebServer(host, 0)
        assert server.url == f"{expected}{server.port}"
        assert server.url_of("2001:db8::1") == f"http://[2001:db8::1]:{server.port}"
        server.close()


def test_ports():
    """If the port is taken, the next free one is, and the address says so; what cannot be had is an error at once. viser tried
    a thousand ports and then waited for ever."""
    with pytest.raises(TypeError, match="port must be a whole number"):
        WebServer("127.0.0.1", "8080")
    for port in (-1, 65536, True):
        with pytest.raises(ValueError, match="ports are 0"):
            WebServer("127.0.0.1", port)
    first = WebServer("127.0.0.1", 0)
    second = WebServer("127.0.0.1", first.port)
    assert first.port < second.port < first.port + web_server.HIGHER
    assert second.url.endswith(f":{second.port}")
    first.close()
    second.close()
    again = WebServer("127.0.0.1", first.port)  # though its connections may linger
    assert again.port == first.port
    again.close()
    with pytest.raises(ValueError, match="no network interface"):
        WebServer("192.0.2.1", 0, token=True)


def test_no_port_is_free(monkeypatch):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        monkeypatch.setattr(web_server, "HIGHER", 1)
        with pytest.raises(OSError, match="port=0") as error:
            WebServer("127.0.0.1", taken.getsockname()[1])
    assert error.value.errno == errno.EADDRINUSE

    def refuse(*_):
        raise PermissionError(errno.EACCES, "Permission denied")

    monkeypatch.setattr(web_server, "_probe", refuse)
    with pytest.raises(PermissionError, match=r"port 80 of '127\.0\.0\.1' cannot be listened on"):
        WebServer("127.0.0.1", 80)


def test_a_scene_that_cannot_be_shown_leaves_no_server(monkeypatch):
    """An error after the server has begun to listen left it behind."""
    started = []

    class Known(WebServer):
        def __init__(self, *arguments):
            super().__init__(*arguments)
            started.append(self)

    def fail(*arguments):
        raise MemoryError("no room")

    monkeypatch.setattr("wrt.viewer.live_view.WebServer", Known)
    monkeypatch.setattr("wrt.viewer.live_view.ScenePanel", fail)
    with pytest.raises(MemoryError):
        wrt.view(scenes.build("teapot", level=4), block=False, port=0)
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection(("127.0.0.1", started[0].port), timeout=1.0)
