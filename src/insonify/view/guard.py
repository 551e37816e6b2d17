"""Who may read the page: a browser that was sent to it by its own address, no other web page.

A browser lets any page open a web socket to this machine, and tells the server whose page it is by
``Origin``; a page that has its own name point to this machine shows by ``Host`` (DNS rebinding).
"""

from __future__ import annotations

import importlib
import ipaddress
import socket
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from http import HTTPStatus
from typing import Any
from urllib.parse import urlsplit

from insonify.errors import OutputError
from insonify.view.dress import dressed


def refusal(host: str | None, origin: str | None, served: str) -> str:
    """Why a request is not answered; nothing if it is.

    Args:
        host: Its ``Host``: this machine by an address, by its own name or by the one that is
            served at.  The port is not looked at, as one that is forwarded is another.
        origin: Its ``Origin``, if it has one: of the page itself.
        served: The address or name that is listened at.
    """
    name = _name(host)
    if host is None or name is None:
        return "the request names no host"
    own = socket.gethostname().lower()
    if not (_is_address(name) or name in {"localhost", own, f"{own}.local", served.lower()}):
        return "the request names a host that is not this machine"
    if origin is not None and urlsplit(origin).netloc.lower() != host.lower():
        return "the request is of another page"
    return ""


@contextmanager
def guarded(served: str) -> Iterator[None]:
    """Let a server that viser starts in the block refuse what `refusal` refuses.

    viser has no place for this, so what it calls to serve is another function meanwhile.

    Raises:
        OutputError: viser did not call it, so that the server is open to all.
    """
    server: Any = importlib.import_module("websockets.asyncio.server")
    serve, called = server.serve, []

    def serve_some(*given: Any, process_request: Any = None, **more: Any) -> Any:
        called.append(True)
        return serve(*given, process_request=_asking(process_request, served), **more)

    server.serve = serve_some
    try:
        yield
    finally:
        server.serve = serve
    if not called:
        raise OutputError(
            "the view cannot be served: this version of viser cannot be kept from answering other "
            "web pages; install one that can: pip install 'insonify[view]'"
        )


def _asking(answer: Any, served: str) -> Callable[[Any, Any], Any]:
    """How requests are answered, once they are not refused."""

    def ask(connection: Any, request: Any) -> Any:
        headers = request.headers
        told = [headers.get_all(name) for name in ("Host", "Origin")]
        if any(len(values) > 1 for values in told):
            return connection.respond(HTTPStatus.BAD_REQUEST, "a header stands twice\n")
        host, origin = (values[0] if values else None for values in told)
        why = refusal(host, origin, served)
        if why:
            return connection.respond(HTTPStatus.FORBIDDEN, f"{why}\n")
        return None if answer is None else dressed(answer(connection, request))

    return ask


def _name(host: str | None) -> str | None:
    """The name in a ``Host``, without the port."""
    try:
        return urlsplit(f"//{host}").hostname if host else None
    except ValueError:
        return None


def _is_address(name: str) -> bool:
    """Whether a name is an IP address, which no one else can point to this machine."""
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True
