"""The WebSocket listener of a gateway: it decides who may connect, and from where.

It checks tokens, origins, host names, TLS and the number of connections. It knows no protocol on top of WebSocket.
What connections may hold is bounded by slidectl/bounded_websocket.py.
"""

from __future__ import annotations

import asyncio
import errno
import http
import logging
import socket
import ssl
import sys
import traceback
from collections.abc import Awaitable, Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from typing import Any, cast
from urllib.parse import parse_qs, urlsplit

from websockets.asyncio.server import Server, ServerConnection, serve
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response

from slidectl import input_files
from slidectl.errors import BadFile, Refused, SlidectlError, UsageError
from slidectl.extensions.gateways.bounded_websocket import (
    CLOSE_S,
    HANDSHAKE_S,
    BoundedConnection,
    ConnectionBounds,
    answering_bad_requests,
)
from slidectl.extensions.gateways.gateway import GatewayOptions
from slidectl.extensions.gateways.strangers import Strangers
from slidectl.web_access import (
    LOOPBACK,
    check_token,
    check_users_can_be_told,
    host_of,
    is_loopback,
    is_secret,
    shown_host,
)

_MORE_HANDSHAKES = 200
"""Connections beyond the limit that still get a refusal as answer; further ones cut the oldest unfinished one."""
_BACKLOG = 1000
"""Connections that the system may keep until they are accepted."""
_MOST_HELD = 128 * 1024 * 1024
"""Limit of the bytes that have come and are not handled, over all connections."""
_MOST_BYTES_OF_KEYS = 2**20
"""The largest file of a token, a certificate or a key, bytes."""


@dataclass(frozen=True)
class ListenerOptions(GatewayOptions):
    """The address where a gateway listens, and who may connect."""

    host: str = "localhost"
    """Address of this machine to listen on; any except loopback needs a token."""
    port: int = 0
    """The port; 0 for a free one."""
    cert: str = ""
    """File with a certificate followed by its chain: the gateway uses TLS (wss://)."""
    key: str = ""
    """File with the certificate's key, if it is not in the same file."""
    token: str = ""
    """Clients must give this token, as ?token=WORD or as the header Authorization: Bearer WORD."""
    token_file: str = ""
    """File with the token, instead of `token`."""
    origins: tuple[str, ...] = ()
    """Sites whose pages may connect, as https://site:port; null for files, * for all. By default no page may."""
    max_connections: int = 200
    """The maximum number of clients at a time."""


class ListenerConnection(BoundedConnection):
    """A connection; it is cut at once when there are too many of other users."""

    def __init__(self, *args: Any, strangers: Strangers, **options: Any) -> None:
        super().__init__(*args, **options)
        self._strangers = strangers
        self.stranger = ""
        """Why the connection is one of another user, who may not come in; empty for others."""

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        super().connection_made(transport)
        self.stranger = self._strangers.seen(self, transport)
        if self.stranger and self._strangers.are_many:
            cast(asyncio.Transport, transport).abort()

    def connection_lost(self, exc: Exception | None) -> None:
        self._strangers.gone(self)
        super().connection_lost(exc)


class WebSocketListener:
    """Listens, and passes accepted connections to a handler."""

    def __init__(self, options: ListenerOptions, known_origins: Sequence[str] = ()) -> None:
        """`known_origins` are allowed in addition to those of the options.

        Raises:
            UsageError, BadFile: options that contradict each other, or files that cannot be used.
        """
        self._options = options
        self._token = _token(options)
        if options.key and not options.cert:
            raise UsageError("--key is that of a certificate: --cert FILE is needed")
        self._tls = _server_context(options.cert, options.key) if options.cert else None
        self._origins = {*map(_checked_origin, options.origins), *known_origins}
        self._server: Server | None = None
        self.bounds = ConnectionBounds(_MOST_HELD, options.max_connections + _MORE_HANDSHAKES, self._tls)
        self.connections = 0
        """The present number of connections."""
        self.refused = 0

    def is_local(self) -> bool:
        """True when only this machine can connect.

        Raises:
            Refused: no such host. UsageError: other machines can connect, and there is no token.
        """
        options = self._options
        try:
            is_local = is_loopback(options.host)
        except OSError as error:
            raise Refused(f"no host {options.host!r} ({error.strerror})", "addresses: localhost, 0.0.0.0") from None
        if not is_local and not self._token:
            raise UsageError(f"--host {options.host} lets other machines in: --token WORD is needed")
        return is_local

    async def open(
        self,
        handler: Callable[[Any], Awaitable[None]],
        kind: type[ListenerConnection] = ListenerConnection,
        **more: Any,
    ) -> str:
        """Listen, and return the address to show. `more` goes to the library's server.

        Raises:
            Refused: the port is taken, or the host is not an address of this machine. UsageError: as `is_local`.
        """
        options = self._options
        self.is_local()
        addresses = _addresses(options.host)
        quiet = logging.getLogger("slidectl.extensions.gateways")
        quiet.setLevel(logging.CRITICAL)  # connections that are no WebSocket are refused; that is not worth a log entry

        if not self._token:
            check_users_can_be_told(options.any_user)
        strangers = Strangers(lets_all_in=bool(self._token) or options.any_user)
        made = partial(kind, bounds=self.bounds, strangers=strangers)

        async def count(connection: ServerConnection) -> None:
            if self.connections >= options.max_connections:  # several connected at the same time
                await connection.close(1013, "too many are connected")
                return
            self.connections += 1
            try:
                await handler(connection)
            except ConnectionClosed:
                pass
            except Exception:  # an internal error ends one connection
                traceback.print_exc(file=sys.stderr)
                await connection.close(1011, "internal error; the log of the gateway has more")
            finally:
                self.connections -= 1

        try:
            self._server = await serve(
                count,
                cast(str, addresses if options.port else addresses[:1]),  # asyncio's server accepts a list
                options.port,
                process_request=answering_bad_requests(self._judge),
                open_timeout=HANDSHAKE_S,
                close_timeout=CLOSE_S,
                backlog=_BACKLOG,
                server_header=None,
                logger=quiet,
                create_connection=cast(type[ServerConnection], made),
                **more,
            )
        except OSError as error:
            raise _not_bound(options, error) from None
        port = self._server.sockets[0].getsockname()[1]
        return f"{'wss' if self._tls else 'ws'}://{shown_host(options.host)}:{port}"

    async def close(self, code: int, reason: str) -> None:
        """Stop listening and end all connections."""
        if self._server is not None:
            self._server.close(code=code, reason=reason)
            await self._server.wait_closed()

    def _judge(self, browser: ServerConnection, request: Request) -> Response | None:
        """The refusal of a connection request; None to accept it."""
        assert isinstance(browser, ListenerConnection)
        status, text = self._objection(request)
        if browser.stranger:
            status, text = http.HTTPStatus.FORBIDDEN, f"{browser.stranger}; see --token and --any-user"
        if not text:
            return None
        self.refused += 1
        response = browser.respond(status, f"slidectl: {text}\n")
        if status == http.HTTPStatus.UNAUTHORIZED:
            response.headers["WWW-Authenticate"] = "Bearer"
        return response

    def _objection(self, request: Request) -> tuple[http.HTTPStatus, str]:
        headers = request.headers
        for name in headers.get_all("Host"):
            if not self._token and host_of(name) not in (*LOOPBACK, self._options.host):
                return http.HTTPStatus.FORBIDDEN, f"this gateway does not go by the name {name!r}"
        for origin in headers.get_all("Origin"):
            if not self._is_allowed_origin(origin):
                return http.HTTPStatus.FORBIDDEN, f"pages of {origin} may not use this gateway; see --origin"
        if self._token:
            given = _given_token(request)
            if given is None:
                where = "?token=WORD in the address, or the header Authorization: Bearer WORD"
                return http.HTTPStatus.UNAUTHORIZED, f"a token is needed: {where}"
            if not is_secret(given, self._token):
                return http.HTTPStatus.UNAUTHORIZED, "the token is wrong"
        if self.connections >= self._options.max_connections:
            most = self._options.max_connections
            return http.HTTPStatus.SERVICE_UNAVAILABLE, f"{most} clients are connected, which is the maximum"
        return http.HTTPStatus.OK, ""

    def _is_allowed_origin(self, origin: str) -> bool:
        """True for pages of the given sites. Programs other than browsers send no origin."""
        return "*" in self._origins or origin.lower() in self._origins


def _token(options: ListenerOptions) -> str:
    """The token of the options. Raises UsageError, BadFile."""
    if options.token and options.token_file:
        raise UsageError("--token and --token-file exclude each other", "give one of them")
    token = options.token
    if options.token_file:
        try:
            token = input_files.read_text(options.token_file, _MOST_BYTES_OF_KEYS).strip()
        except BadFile as error:
            raise BadFile(f"the token file {options.token_file} cannot be read: {error.reason}") from None
        check_token(token)
    return check_token(token) if token else ""


def _given_token(request: Request) -> str | None:
    for text in request.headers.get_all("Authorization"):
        scheme, _, word = text.partition(" ")
        if scheme.lower() == "bearer":
            return word.strip()
    return parse_qs(urlsplit(request.path).query).get("token", [None])[0]


def _checked_origin(origin: str) -> str:
    """The origin as browsers write it. Raises UsageError."""
    given = origin.lower().rstrip("/")
    if given in ("*", "null"):
        return given
    try:
        parts = urlsplit(given)
        is_site = bool(parts.scheme and parts.hostname) and given == f"{parts.scheme}://{parts.netloc}"
    except ValueError:
        is_site = False
    if not is_site:
        raise UsageError(
            f"{origin!r} is not an origin", "origins: https://site, http://site:8000, null for files, * for all"
        )
    return given


def _addresses(host: str) -> list[str]:
    """The host's addresses that belong to this machine: others cannot be listened on. Raises Refused."""
    found: dict[str, None] = {}
    for family, kind, _, _, address in socket.getaddrinfo(host, None, type=socket.SOCK_STREAM):
        with suppress(OSError), socket.socket(family, kind) as probe:
            probe.bind((address[0], 0))
            found[str(address[0])] = None
    if not found:
        raise Refused(f"{host} is not an address of this machine", "addresses: localhost, 0.0.0.0")
    return list(found)


def _not_bound(options: ListenerOptions, error: OSError) -> SlidectlError:
    where = f"port {options.port} of {options.host}"
    if error.errno == errno.EADDRINUSE:
        return Refused(f"{where} is taken", "choose another port")
    if error.errno == errno.EACCES:
        return Refused(f"{where} is for root alone", "choose a port from 1024 on")
    return Refused(f"cannot listen on {where}: {error.strerror}")


def _server_context(cert: str, key: str) -> ssl.SSLContext:
    """A TLS context for the certificate (PEM, followed by its chain) and the key, which may be in the same file.

    Raises:
        BadFile: a file cannot be read or is invalid, they do not match, or the certificate is not valid today.
    """
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    files = cert if not key else f"{cert} and {key}"

    def no_password() -> str:
        raise BadFile(f"the key in {key or cert} is encrypted", "write it without: openssl pkey -in KEY -out NEW")

    for file in (cert, key) if key else (cert,):
        try:
            input_files.opened(file, _MOST_BYTES_OF_KEYS).close()  # the library would wait for a pipe
        except BadFile as error:
            raise BadFile(f"{file} cannot be read: {error.reason}", hint="options: --cert FILE --key FILE") from None
    try:
        context.load_cert_chain(cert, key or None, no_password)
    except ssl.SSLError as error:
        reasons = {"KEY_VALUES_MISMATCH": "the key is not that of the certificate"}
        reason = reasons.get(error.reason or "", "they do not hold a certificate and its key as PEM")
        raise BadFile(f"{files} cannot be used: {reason}", "options: --cert FILE --key FILE") from None
    except OSError as error:
        raise BadFile(f"{files} cannot be read: {error.strerror}", "options: --cert FILE --key FILE") from None
    _check_dates(context, cert)
    return context


def _check_dates(context: ssl.SSLContext, cert: str) -> None:
    """Check the certificate's dates: do a handshake in memory with a client that trusts it. Raises BadFile."""
    trusting = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    trusting.check_hostname = False
    trusting.verify_flags = ssl.VerifyFlags.VERIFY_X509_PARTIAL_CHAIN
    trusting.load_verify_locations(cert)
    to_server, to_client = ssl.MemoryBIO(), ssl.MemoryBIO()
    server = context.wrap_bio(to_server, to_client, server_side=True)
    client = trusting.wrap_bio(to_client, to_server)
    for side in (client, server, client):
        try:
            side.do_handshake()
        except ssl.SSLWantReadError:
            continue
        except ssl.SSLCertVerificationError as error:
            hint = f"look at it: openssl x509 -noout -dates -in {cert}"
            raise BadFile(f"no browser will take {cert}: {error.verify_message}", hint) from None
