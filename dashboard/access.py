"""Access to the page: a token, and the checks of each request and each websocket handshake.

viser accepts a websocket from every origin, so any web page that the same browser shows could
command the network. Browsers tell the origin of a handshake truly; other programs lack the token.
"""

import http
import logging
import secrets
import socket
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from hashlib import sha256
from http.cookies import CookieError, SimpleCookie
from ipaddress import ip_address
from threading import Lock
from typing import Any
from urllib.parse import parse_qs, urlsplit

from websockets.asyncio import server as websocket_server
from websockets.datastructures import Headers
from websockets.http11 import Request, Response

from concord.dashboard.shell import ALIVE, with_shell

Answer = Callable[[Any, Request], Response | None]
"""(connection, request): the response, or None where a websocket handshake goes on."""

_TOKEN_BYTES = 24
_NO_TOKEN = (
    "This page needs the token of its address: open the whole address that concord printed "
    "(http://.../?token=...).\n"
)
_STRANGE_HOST = (
    "The host name of this request is not one of this page; if a proxy has it, start concord with "
    "--public-name NAME.\n"
)
_STRANGE_ORIGIN = (
    "Only the page itself may open this connection; behind a proxy, start concord with "
    "--public-name NAME.\n"
)
_PAGE_HEADERS = {
    # No other page may show this one in a frame and have a person press its buttons unseen.
    "Content-Security-Policy": "frame-ancestors 'none'",
    "X-Frame-Options": "DENY",
    # The address holds the token.
    "Referrer-Policy": "no-referrer",
}
_serve_lock = Lock()
PUBLIC_NAMES: set[str] = set()
"""Names under which proxies show the pages of this process, such as viz.example.org."""


class PageAccess:
    """The rules of access to one page, which listens at `host`.

    A request must name this machine as its host, or a public name. It shows the token as a
    parameter of the address or, from then on, as a cookie. A websocket handshake must come from the
    origin of the page, or from one with a public name: a proxy may name this machine as the host.
    """

    def __init__(self, host: str, public_names: Iterable[str] | None = None) -> None:
        self.adopt(secrets.token_urlsafe(_TOKEN_BYTES))
        public = PUBLIC_NAMES if public_names is None else public_names
        self._public = {name.lower() for name in public}
        own = {"localhost", host.lower(), socket.gethostname().lower(), socket.getfqdn().lower()}
        self._names = own | self._public

    def adopt(self, token: str) -> None:
        """Let browsers in that show this token, and no other."""
        self.token = token
        # Pages of one machine share its cookies, whatever their ports are.
        self._cookie = f"concord-{sha256(token.encode()).hexdigest()[:12]}"

    def refusal(self, request: Request) -> str | None:
        """Return why a request is refused, in one sentence; None if it is allowed."""
        hosts = request.headers.get_all("Host")
        if len(hosts) != 1 or not self._is_own(hosts[0]):
            return _STRANGE_HOST
        if "Upgrade" in request.headers:
            origins = request.headers.get_all("Origin")
            same = (f"http://{hosts[0]}", f"https://{hosts[0]}")
            if len(origins) != 1 or not (origins[0] in same or self._is_public(origins[0])):
                return _STRANGE_ORIGIN
        shown = (*self._in_address(request), *self._in_cookies(request))
        # Bytes: text must be ASCII to be compared in constant time.
        known = self.token.encode()
        if not any(secrets.compare_digest(one.encode(), known) for one in shown):
            return _NO_TOKEN
        return None

    def checked(self, answer: Answer) -> Answer:
        """Return `answer` for requests that are allowed, and a refusal (403) for all others."""

        def check(connection: Any, request: Request) -> Response | None:
            refusal = self.refusal(request)
            if refusal is not None:
                return _forbidden(refusal)
            if request.path == ALIVE:
                return Response(http.HTTPStatus.NO_CONTENT, "No Content", Headers())
            response = answer(connection, request)
            if response is not None:
                response = with_shell(response)
                response.headers.update(_PAGE_HEADERS)
                response.headers["Set-Cookie"] = (
                    f"{self._cookie}={self.token}; Path=/; HttpOnly; SameSite=Strict"
                )
            return response

        return check

    @contextmanager
    def guarding(self) -> Iterator[None]:
        """Check the requests of the servers that viser starts within this block.

        viser has no setting for it, so the block replaces the function that starts a server.
        """
        plain: Any = websocket_server.serve

        def serve(*place: Any, process_request: Answer, **options: Any) -> Any:
            options["logger"] = _LOGGER
            return plain(*place, process_request=self.checked(process_request), **options)

        with _serve_lock:
            websocket_server.serve = serve
            try:
                yield
            finally:
                websocket_server.serve = plain

    def _is_own(self, host: str) -> bool:
        """Return whether a Host header names this machine.

        A foreign name that resolves to this machine is the attack called DNS rebinding; it needs a
        name, so every address in numbers is allowed.
        """
        try:
            name = urlsplit(f"//{host}").hostname or ""
        except ValueError:
            return False
        return name in self._names or _is_address(name)

    def _is_public(self, origin: str) -> bool:
        """Return whether an origin has a public name; its port is the proxy's."""
        try:
            return (urlsplit(origin).hostname or "") in self._public
        except ValueError:
            return False

    def _in_address(self, request: Request) -> list[str]:
        return parse_qs(urlsplit(request.path).query).get("token", [])

    def _in_cookies(self, request: Request) -> list[str]:
        found = []
        for header in request.headers.get_all("Cookie"):
            try:
                cookies = SimpleCookie(header)
            except CookieError:
                continue
            if self._cookie in cookies:
                found.append(cookies[self._cookie].value)
        return found


def _is_address(name: str) -> bool:
    try:
        ip_address(name)
    except ValueError:
        return False
    return True


def _forbidden(why: str) -> Response:
    body = why.encode()
    headers = Headers({
        "Content-Type": "text/plain; charset=utf-8",
        "Content-Length": str(len(body)),
        "Connection": "close",
    })  # fmt: skip
    return Response(http.HTTPStatus.FORBIDDEN, "Forbidden", headers, body)


def _is_worth_a_line(record: logging.LogRecord) -> bool:
    """Drop connections that end before they ask for anything; tell of others in one line."""
    record.exc_info = record.exc_text = None
    return record.getMessage() != "opening handshake failed"


_LOGGER = logging.getLogger("concord.dashboard.connections")
_LOGGER.addFilter(_is_worth_a_line)
