"""viser's server with access control: who may open the page, and what browsers may send to viser, and how much.

The files of the page and the WebSocket of its panels are served by the same server, behind the same guard.

viser has no hook for that. It calls `websockets.asyncio.server.serve`, which is wrapped while viser starts; only this
file does that. Tests connect with wrong tokens and foreign origins, and send invalid messages.
"""

from __future__ import annotations

import http
import io
import logging
import math
import secrets
import socket
import warnings
from contextlib import contextmanager, redirect_stdout
from functools import partial
from html import escape
from typing import TYPE_CHECKING, Any
from urllib.parse import parse_qs, urlencode, urlsplit

import msgspec
import viser
import websockets.asyncio.server
from viser import _messages
from websockets.asyncio.server import ServerConnection
from websockets.datastructures import Headers
from websockets.http11 import Request, Response

from slidectl.errors import Refused, UnknownName
from slidectl.extensions.gateways.bounded_websocket import ConnectionBounds, answering_bad_requests
from slidectl.extensions.viewing.page.page_files import PageFiles
from slidectl.extensions.viewing.page.rosbridge_endpoint import PATH, PageConnection, RosbridgeEndpoint
from slidectl.operating_system import return_large_blocks
from slidectl.web_access import LOOPBACK, host_of, is_secret, stranger

if TYPE_CHECKING:
    from collections.abc import Iterator

_PORTS_TRIED = 100
_MOST_BROWSERS = 100
_MOST_PLACES = 400
"""Connections, before, during and after their handshakes. Browsers open some more for the files of the page."""
_LONGEST_MESSAGE = 2 * 1024 * 1024
"""Bytes of a message of a browser."""
_PONG_WITHIN_S = 60.0
_MOST_HELD = 32 * 1024 * 1024
"""Limit of the bytes that have come and are not handled, over all browsers."""
_TAKEN = {
    kind.__name__: kind
    for kind in (
        _messages.SceneNodeDragMessage, _messages.TransformControlsDragEndMessage,
        _messages.TransformControlsDragStartMessage, _messages.TransformControlsUpdateMessage,
        _messages.ViewerCameraMessage,
    )
}  # fmt: skip
"""The messages that the scene uses. Some others would be stored for ever (uploads) or sent to all browsers (forms)."""
_KEPT_OUT = {"X-Frame-Options": "SAMEORIGIN", "Referrer-Policy": "same-origin", "Cache-Control": "no-store"}
"""Headers of the page: foreign pages cannot frame it, and an address with a token is not sent to other sites."""


def free_port(host: str, first: int) -> int:
    """The first free port from `first` on, out of a hundred.

    Raises:
        UnknownName: the host is no address of this machine. Refused: all ports are taken.
    """
    try:
        family, kind, *_, address = socket.getaddrinfo(host, first, type=socket.SOCK_STREAM)[0]
        with socket.socket(family, kind) as probe:
            probe.bind((address[0], 0))
    except OSError as error:
        raise UnknownName("local address", host, list(LOOPBACK[:2]), f"({error.strerror})") from error
    for port in range(first, min(first + _PORTS_TRIED, 65536)) if first else (0,):
        with socket.socket(family, kind) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                probe.bind((address[0], port))
            except PermissionError as error:
                raise Refused(f"port {port} is for root alone", "choose one from 1024 on: --port N") from error
            except OSError:
                continue
            return int(probe.getsockname()[1])
    raise Refused(f"the ports {first} to {first + _PORTS_TRIED - 1} of {host} are taken", "choose another: --port N")


class AccessGuard:
    """Accepts requests that have the token and come from the page itself."""

    def __init__(self, host: str, token: str, any_user: bool = False) -> None:
        """`token` is empty if none is needed; then only browsers of this process's user may come, or `any_user`."""
        self._any_user = any_user
        self._host = host
        self._token = token
        self._word = ""
        self._session = secrets.token_urlsafe()
        """The value of the cookie. It is good for this server only: browsers send cookies to all ports of a host."""

    def stranger(self, connection: ServerConnection) -> Response | None:
        """The refusal of a connection of another user of this machine, who has no token to show; None for others."""
        if self._token or self._any_user:
            return None
        why = stranger(connection.remote_address[:2], connection.local_address[:2])
        return _refused(f"{why}; see --token and --any-user") if why else None

    def answer(self, request: Request) -> Response | None:
        """The response that replaces the page: a refusal or redirect; None to serve the page."""
        headers, url = request.headers, urlsplit(request.path)
        named = headers.get("Host", "")
        # DNS rebinding: a foreign site's name may resolve to this machine. It opens the page only with a token.
        if not self._token and host_of(named) not in (*LOOPBACK, self._host):
            return _refused(f"this page does not go by the name {named!r}")
        origin = headers.get("Origin")
        if origin is not None and urlsplit(origin).netloc != named:
            return _refused(f"pages of {origin} may not use this one")
        if headers.get("Sec-Fetch-Site") == "cross-site" and headers.get("Sec-Fetch-Mode") != "navigate":
            return _refused("other pages may not use this one")
        query = parse_qs(url.query)
        if self._token:
            given = query.pop("token", [""])[0]
            if given and (is_secret(given, self._token) or self._is_word(given)):
                more = f"?{urlencode(query, doseq=True)}" if query else ""
                cookie = f"{_cookie_name(named)}={self._session}; HttpOnly; SameSite=Strict; Path=/"
                return _sent_on(f"/{more}", cookie, is_foreign=headers.get("Sec-Fetch-Site") == "cross-site")
            if not any(is_secret(value, self._session) for value in _cookies(headers, _cookie_name(named))):
                what = "the token is wrong" if given else "a token is needed"
                return _refused(f"{what}: the whole address is printed by slidectl view")
        return None

    def word(self) -> str:
        """Make a one-time word to use in place of the token: a browser's arguments show in the process list."""
        self._word = secrets.token_urlsafe()
        return self._word

    def _is_word(self, given: str) -> bool:
        is_it = bool(self._word) and is_secret(given, self._word)
        if is_it:
            self._word = ""
        return is_it


def _cookie_name(named: str) -> str:
    """The cookie's name at this `Host`: pages at several ports of a host, or behind tunnels, have one each."""
    return f"slidectl-{urlsplit(f'//{named}').port or 80}"


def _cookies(headers: Headers, name: str) -> list[str]:
    """The values of all cookies of this name. Cookies of other programs at this host may have any form."""
    pairs = [part.partition("=") for text in headers.get_all("Cookie") for part in text.split(";")]
    return [value.strip() for key, _, value in pairs if key.strip() == name]


def _sent_on(where: str, cookie: str, is_foreign: bool) -> Response:
    """Lead a browser to the page, with its cookie. After a link of another site, browsers do not send a strict cookie
    where a redirect leads; they do where a page of this server leads.
    """
    headers = Headers({"Set-Cookie": cookie, **_KEPT_OUT})
    if not is_foreign:
        headers["Location"] = where
        return Response(302, "Found", headers)
    headers["Content-Type"] = "text/html; charset=utf-8"
    text = f'<!DOCTYPE html><meta http-equiv="refresh" content="0; url={escape(where)}">\n'
    return Response(200, "OK", headers, text.encode())


def _refused(text: str, status: http.HTTPStatus = http.HTTPStatus.FORBIDDEN) -> Response:
    headers = Headers({"Content-Type": "text/plain; charset=utf-8", "Connection": "close"})
    return Response(status, status.phrase, headers, f"slidectl: {text}\n".encode("utf-8", "replace"))


class GuardedServer(viser.ViserServer):
    """viser's server without log output and without its offer to share the page on the internet."""

    def __init__(self, host: str, port: int, guard: AccessGuard, endpoint: RosbridgeEndpoint) -> None:
        """`endpoint` serves the panels."""
        return_large_blocks()
        logging.getLogger("websockets.server").addFilter(_is_no_handshake)
        # A browser may go while the names of frames are placed for its camera.
        warnings.filterwarnings("ignore", r"Queued a \w+ on a closed connection")
        with _guarded(guard, self, endpoint), redirect_stdout(io.StringIO()):
            super().__init__(host=host, port=port, label="slidectl", verbose=False)
        self.gui.configure_theme(show_logo=False, show_share_button=False)

    def request_share_url(self, verbose: bool = True) -> str | None:  # noqa: ARG002
        """Return None: a browser could ask viser to publish the page on the internet, which is not allowed."""
        return None

    def takes(self, frame: Any) -> bool:
        """True when a browser's message is valid for viser and the scene.

        viser itself sets attributes from any message before it checks their types.

        Raises:
            msgspec.MsgspecError, TypeError, RecursionError: a message that no browser sends.
        """
        message = msgspec.msgpack.decode(frame, type=dict[str, Any])
        kind = _TAKEN.get(message.pop("type", None))
        if kind is None or not _is_finite(message):
            return False
        sound = msgspec.convert(message, kind)
        return message.keys() <= vars(sound).keys()

    def stop(self) -> None:
        with redirect_stdout(io.StringIO()):
            super().stop()


def _is_finite(value: Any) -> bool:
    if isinstance(value, dict):
        value = list(value.values())
    if isinstance(value, list):
        return all(map(_is_finite, value))
    return not isinstance(value, float) or math.isfinite(value)


def _is_no_handshake(record: logging.LogRecord) -> bool:
    """False for failed handshakes of clients that are no browser: they need no traceback in the log."""
    return record.getMessage() != "opening handshake failed"


@contextmanager
def _guarded(guard: AccessGuard, server: GuardedServer, endpoint: RosbridgeEndpoint) -> Iterator[None]:
    serve = websockets.asyncio.server.serve

    def guarded(handler: Any, host: str, port: int, **options: Any) -> Any:
        page = options.pop("process_request")
        bounds = ConnectionBounds(_MOST_HELD, _MOST_PLACES)
        files = PageFiles()

        @answering_bad_requests
        def judge(connection: Any, request: Request) -> Response | None:
            answer = guard.answer(request)
            path = urlsplit(request.path).path
            here = len(endpoint.browsers)
            taken = here if path == PATH else bounds.open - here
            if answer is None and "Upgrade" in request.headers and taken >= _MOST_BROWSERS:
                text = f"{_MOST_BROWSERS} browsers have the page open, and no more may"
                answer = _refused(text, http.HTTPStatus.SERVICE_UNAVAILABLE)
            if answer is None and "Upgrade" not in request.headers:
                answer = files.answer(path, request.headers.get("Accept-Encoding", ""))
            return answer or page(connection, request)

        def process_request(connection: Any, request: Request) -> Response | None:
            answer = guard.stranger(connection) or judge(connection, request)
            if answer is not None:
                for name, value in _KEPT_OUT.items():
                    if name not in answer.headers:
                        answer.headers[name] = value
            return answer

        async def handle(connection: Any) -> None:
            if urlsplit(connection.request.path).path == PATH:
                await endpoint.handle(connection)
                return
            if connection.subprotocol != f"viser-v{viser.__version__}":  # viser would print a line for each
                await connection.close(1002, f"this page is of viser {viser.__version__}: load it again")
                return
            receive = connection.recv

            async def receive_sound() -> Any:
                while True:
                    frame = await receive()
                    try:
                        if server.takes(frame):
                            return frame
                    except (msgspec.MsgspecError, TypeError, RecursionError):
                        await connection.close(1008, "this is no message of the page")

            connection.recv = receive_sound
            await handler(connection)

        # A browser that draws by software on a busy machine may not answer a ping for long.
        options |= {"ping_timeout": _PONG_WITHIN_S}
        options |= {"max_size": _LONGEST_MESSAGE, "create_connection": partial(PageConnection, bounds=bounds)}
        return serve(handle, host, port, process_request=process_request, **options)

    websockets.asyncio.server.serve = guarded  # type: ignore[misc, assignment]
    try:
        yield
    finally:
        websockets.asyncio.server.serve = serve  # type: ignore[misc]
