"""Who may speak to a viewer: tokens, and pages of other sites. No browser; a websocket client asks."""

import warnings
from urllib.error import HTTPError
from urllib.request import urlopen

import pytest

import wrt
from wrt import scenes

viser = pytest.importorskip("viser", reason="the viewer needs viser: pip install 'wrt[view]'")
client = pytest.importorskip("websockets.sync.client")
from websockets.exceptions import InvalidStatus  # noqa: E402 (comes with viser)

from wrt.viewer import web_server  # noqa: E402
from wrt.viewer.web_server import Gate, WebServer, is_local  # noqa: E402

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


def test_local_interfaces():
    assert all(map(is_local, ("127.0.0.1", "127.1.2.3", "localhost", "::1")))
    assert not any(map(is_local, ("0.0.0.0", "::", "192.168.0.7", "")))


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
    ],
)
def test_gate(token, only_here, path, headers, expected):
    assert Gate(token, only_here).admit(path, headers) == expected


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


def test_addresses():
    for host, expected in (("127.0.0.1", "http://127.0.0.1:"), ("localhost", "http://localhost:")):
        server = WebServer(host, 0)
        assert server.url == f"{expected}{server.port}"
        assert server.url_of("2001:db8::1") == f"http://[2001:db8::1]:{server.port}"
        server.close()
