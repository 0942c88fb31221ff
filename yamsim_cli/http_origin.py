"""Accepts or refuses HTTP and WebSocket requests by their `Host` and `Origin` headers.

A web page that a user visits can send requests to servers on the user's machine. A browser names the page's site in
`Origin`. A hostile site can let its own name point to this machine (DNS rebinding). `Host` then has the site's name.
"""

from __future__ import annotations

import ipaddress
import socket
from collections.abc import Sequence
from urllib.parse import SplitResult, urlsplit

_LOOPBACK_NAME = "localhost"


def refusal_reason(hosts: Sequence[str], origins: Sequence[str], bound: str) -> str | None:
    """Return the reason to refuse a request to a server that listens on `bound`; None if it is accepted.

    Requests from pages of this server are accepted, as are requests without `Origin`, which come from other programs.
    `bound` is `0.0.0.0` or `::` for all addresses of this machine.
    """
    if len(hosts) > 1 or len(origins) > 1:
        return "more than one Host or Origin header"
    host = _split_url(f"//{hosts[0]}") if hosts else None
    if hosts and (host is None or not _is_own_host(host.hostname or "", bound)):
        return f"Host {hosts[0][:100]!r} is not this server"
    if not origins:
        return None
    origin = _split_url(origins[0])
    same = origin is not None and origin.scheme in ("http", "https") and hosts
    if not same or origin is None or origin.netloc.lower() != hosts[0].lower():
        return f"Origin {origins[0][:100]!r} is another site"
    return None


def _split_url(url: str) -> SplitResult | None:
    """Return the parts of a URL; None if it is invalid, or has more parts than scheme, host and port."""
    try:
        parts = urlsplit(url)
        _ = parts.port
    except ValueError:
        return None
    return parts if not (parts.username or parts.path or parts.query or parts.fragment) else None


def _is_own_host(name: str, bound: str) -> bool:
    name, bound = name.lower().rstrip("."), bound.lower()
    try:
        address = ipaddress.ip_address(name)
    except ValueError:
        machine = socket.gethostname().lower() if bound in ("0.0.0.0", "::", "") else bound
        return name in (_LOOPBACK_NAME, bound, machine)
    # No site can make a browser send an address instead of the site's name.
    return address.is_loopback or name == bound or bound in ("0.0.0.0", "::", "")
