"""
Who may talk to the dashboard: nobody but pages that the dashboard itself served.

A web page from elsewhere can make the browser send requests to 127.0.0.1, and can
even make its own name point there (DNS rebinding). The first is recognised by the
Origin header, the second by the Host header; buttons need a secret besides, which
only the dashboard's own page holds.
"""

from __future__ import annotations

import ipaddress
import secrets
from urllib.parse import urlsplit


def new_token() -> str:
    """Make a secret that lives as long as the process."""
    return secrets.token_urlsafe(32)


def same_token(given: object, token: str) -> bool:
    """Compare without telling by the time taken how much was right."""
    return isinstance(given, str) and secrets.compare_digest(given.encode(), token.encode())


def host_allowed(host_header: str, bound_host: str) -> bool:
    """
    Tell whether the name in a Host header is one that only this machine can have.

    The port is left open, so that a tunnel (``ssh -L``) works. An address cannot be
    made to point elsewhere, a name can; so names other than ``localhost`` and the
    one given on purpose are refused, and on a loopback address also the addresses
    of networks.
    """
    try:
        name = urlsplit(f'//{host_header}').hostname or ''
    except ValueError:
        return False
    if name in ('localhost', bound_host.lower()):
        return bool(name)
    address = _address(name)
    if address is None:
        return False
    return address.is_loopback or not _is_loopback(bound_host)


def origin_allowed(origin: str | None, host_header: str) -> bool:
    """Tell whether a request comes from a page of the host it goes to, or from no page."""
    return origin is None or origin == f'http://{host_header}'


def _address(name: str) -> ipaddress.IPv4Address | ipaddress.IPv6Address | None:
    try:
        return ipaddress.ip_address(name)
    except ValueError:
        return None


def _is_loopback(host: str) -> bool:
    address = _address(host)
    return host == 'localhost' if address is None else address.is_loopback
