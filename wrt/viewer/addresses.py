"""Whose requests are answered: tokens, and the names under which a request may speak of the server.

    token given   the address holds it as its path: http://HOST:8080/TOKEN/. All other requests are refused.
    none          `Host` must name this computer, and `Origin`, which a browser adds for the page from which a connection comes,
                  must name the same server. Pages of other sites are refused.

A name under somebody else's control can be made to resolve to 127.0.0.1 after its page was loaded (DNS rebinding); the
browser then sends that name as `Host` and as `Origin`. So names are compared as a whole and addresses as numbers, never by
how they begin. What is not written as here is refused, although a resolver may know it:

    localhost   127.0.0.1 (four decimal numbers; all of 127.0.0.0/8)   [::1]   the interface that the server listens on

and, where other computers reach the server, every address written in numbers, which no name server decides about, and the
name of this computer.

References: jackson-2007.
"""

from __future__ import annotations

import re
import secrets
import socket
from collections.abc import Mapping
from dataclasses import dataclass
from ipaddress import IPv4Address, IPv6Address, ip_address, ip_network

__all__ = ["Gate", "is_local", "parse_server"]

LOOPBACK = ip_network("127.0.0.0/8"), ip_network("::1/128")
SCHEMES = {"http": 80, "https": 443}
"""Of pages that may open a connection, and their ports."""

SERVER = re.compile(r"(?:\[(?P<v6>[0-9A-Fa-f:.]+)\]|(?P<name>[A-Za-z0-9_.-]+))(?::(?P<port>[0-9]{1,5}))?", re.ASCII)

Name = IPv4Address | IPv6Address | str
"""An address, or a name in small letters."""


@dataclass(frozen=True)
class Gate:
    """Which requests are answered.

    Attributes:
        token: that the path of an address must begin with; None for none.
        only_here: whether only this computer can reach the server.
        host: the interface that the server listens on; None for one without a name of its own.
    """

    token: str | None
    only_here: bool
    host: str | None = None

    def admit(self, path: str, headers: Mapping[str, str]) -> str | None:
        """The path without the token; None to refuse the request."""
        if self.token is not None:
            first, slash, rest = path.partition("?")[0].removeprefix("/").partition("/")
            return slash + rest or "/" if secrets.compare_digest(first.encode(), self.token.encode()) else None
        hosts, origins = values_of(headers, "Host"), values_of(headers, "Origin")
        if len(hosts) != 1 or len(origins) > 1:
            return None
        server = parse_server(hosts[0])
        if server is None or not self._is_known(server[0]):
            return None
        return path if not origins or is_page_of(origins[0], server) else None

    def _is_known(self, name: Name) -> bool:
        """Whether this computer is called so."""
        if is_loopback(name) or (self.host and name == parse_name(self.host)):
            return True
        return not self.only_here and (not isinstance(name, str) or name == socket.gethostname().lower())


def is_local(host: str) -> bool:
    """Whether only this computer reaches a network interface: localhost, or a loopback address in full."""
    name = parse_name(host)
    return name is not None and is_loopback(name)


def is_loopback(name: Name) -> bool:
    """Whether a name or an address is that of this computer, for itself alone."""
    return name == "localhost" if isinstance(name, str) else any(name in network for network in LOOPBACK)


def parse_name(host: str) -> Name | None:
    """An address from its numbers, in full and without brackets; else a name in small letters; None for neither."""
    if "%" in host:  # a zone of an IPv6 address
        return None
    try:
        return ip_address(host)
    except ValueError:
        found = SERVER.fullmatch(host)
    if found is None or not found["name"] or found["port"]:
        return None
    last = found["name"].rpartition(".")[2]
    is_number = not last or last[0].isdigit()  # 127.1, 0x7f.1, 2130706433: resolvers take them for addresses; or a last dot
    return None if is_number else host.lower()


def parse_server(text: str) -> tuple[Name, int | None] | None:
    """The name and the port of `NAME`, `NAME:PORT`, `[IPV6]` or `[IPV6]:PORT`; None for any other text.

    Without a port it is None.
    """
    found = SERVER.fullmatch(text)
    if found is None:
        return None
    name = parse_name(found["v6"] or found["name"])
    port = None if found["port"] is None else int(found["port"])
    if name is None or isinstance(name, IPv6Address) != bool(found["v6"]) or (port is not None and not 0 < port < 65536):
        return None
    return name, port


def is_page_of(origin: str, server: tuple[Name, int | None]) -> bool:
    """Whether an `Origin` is a page of this server: SCHEME://NAME[:PORT], and nothing else."""
    scheme, mark, rest = origin.partition("://")
    page, default = parse_server(rest), SCHEMES.get(scheme.lower())
    if not mark or page is None or default is None:
        return False
    return page[0] == server[0] and (page[1] or default) == (server[1] or default)


def values_of(headers: Mapping[str, str], name: str) -> list[str]:
    """All values of a header, which may be there several times."""
    every = getattr(headers, "get_all", None)
    return every(name) if every is not None else [headers[name]] if name in headers else []
