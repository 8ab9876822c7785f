"""Whose requests are answered without a token: what `Host` and `Origin` may say. No server is needed."""

import socket

import pytest

from wrt.viewer.addresses import Gate, is_local, parse_server

HERE = Gate(None, True, "127.0.0.1")
ANSWERED = (
    "localhost",
    "localhost:8080",
    "LOCALHOST:8080",
    "127.0.0.1:1",
    "127.0.0.1:65535",
    "127.255.255.254",
    "[::1]",
    "[::1]:8080",
    "[0:0:0:0:0:0:0:1]:8080",
)
REFUSED = (
    "",
    " ",
    "127.evil.com",
    "127.0.0.1.evil.com",
    "localhost.evil.com",
    "evil-localhost",
    "evil.com:8080",
    "localhost.",
    "127.0.0.1.",
    "127.1",
    "127.0.1",
    "127.0.0.01",
    "127.0.0.256",
    "0x7f.1",
    "0x7f000001",
    "0177.0.0.1",
    "2130706433",
    "0",
    "0.0.0.0",
    "128.0.0.1",
    "126.255.255.255",
    "::1",
    "[::1",
    "[::2]",
    "[::ffff:127.0.0.1]",
    "[::1%lo]",
    "[127.0.0.1]",
    "[localhost]",
    "user@localhost",
    "localhost@evil.com",
    "localhost:8080@evil.com",
    "localhost:",
    "localhost:0",
    "localhost:65536",
    "localhost:+80",
    "localhost:80:80",
    "localhost:8080/",
    "localhost/evil.com",
    "localhost, evil.com",
    "localhost evil.com",
    " localhost",
    "localhost\t",
    "localhost\n",
    "localhost\0",
    "xn--lcalhost-54a",
    "l\u043ecalhost",
    "\uff11\uff12\uff17.0.0.1",
    "127.0.0.\u0661",
    "http://localhost",
    "*",
)


def admits(gate, **headers):
    return gate.admit("/", {name.capitalize(): value for name, value in headers.items()}) is not None


@pytest.mark.parametrize("host", ANSWERED)
def test_names_of_this_computer(host):
    assert admits(HERE, host=host)
    assert admits(HERE, host=host, origin=f"http://{host}")
    assert not admits(HERE, host=host, origin="http://evil.com")


@pytest.mark.parametrize("host", REFUSED)
def test_other_names(host):
    """Names were compared by how they begin: 127.evil.com was taken for 127.0.0.1, and its pages moved the camera."""
    assert not admits(HERE, host=host)
    assert not admits(HERE, host=host, origin=f"http://{host}")
    assert not admits(HERE, host="localhost:8080", origin=f"http://{host}")


def test_headers_that_are_missing_or_several():
    Headers = pytest.importorskip("websockets.datastructures", reason="comes with viser, the extra view").Headers
    assert not admits(HERE)
    assert not admits(HERE, origin="http://localhost")
    for name in ("Host", "Origin"):
        headers = Headers([("Host", "localhost"), ("Origin", "http://localhost")])
        assert HERE.admit("/", headers) == "/"
        headers[name] = "localhost" if name == "Host" else "http://localhost"
        assert HERE.admit("/", headers) is None


@pytest.mark.parametrize(
    ("host", "origin", "expected"),
    [
        ("localhost:8080", "http://localhost:8080", True),
        ("localhost:8080", "HTTP://LocalHost:8080", True),
        ("localhost:8080", "http://localhost:8081", False),  # another server of this computer
        ("localhost:8080", "http://127.0.0.1:8080", False),
        ("localhost:8080", "http://localhost", False),
        ("localhost", "http://localhost:80", True),
        ("localhost", "https://localhost:443", True),
        ("localhost:443", "https://localhost", True),
        ("localhost:80", "https://localhost", False),
        ("localhost", "null", False),
        ("localhost", "", False),
        ("localhost", "localhost", False),
        ("localhost", "file://localhost", False),
        ("localhost", "http://localhost/", False),
        ("localhost", "http://user@localhost", False),
        ("localhost", "http://localhost http://evil.com", False),
    ],
)
def test_pages(host, origin, expected):
    assert admits(HERE, host=host, origin=origin) == expected


def test_where_others_reach_it():
    """Numbers need no name server; of names, only those of this computer."""
    gate = Gate(None, False, "Box.example")
    for name in ("box.example:8080", "192.168.0.7:8080", "[2001:db8::1]:8080", "localhost", socket.gethostname()):
        assert admits(gate, host=name, origin=f"http://{name}")
    for name in ("evil.com", "192.168.0.7.evil.com", "192.168.7", "box.example.evil.com", "xbox.example"):
        assert not admits(gate, host=name, origin=f"http://{name}")


def test_interfaces_of_this_computer():
    for host in ("localhost", "LocalHost", "127.0.0.1", "127.1.2.3", "127.255.255.255", "::1", "0:0:0:0:0:0:0:1"):
        assert is_local(host)
    others = ("0.0.0.0", "::", "", "192.168.0.7", "128.0.0.1", "127.evil.com", "127.1", "localhost.evil.com", "::2", "[::1]")
    for host in others:
        assert not is_local(host)


def test_what_is_read_is_what_was_written():
    name, port = parse_server("[2001:DB8::1]:80")
    assert (str(name), port) == ("2001:db8::1", 80)
    assert parse_server("Example.org") == ("example.org", None)
