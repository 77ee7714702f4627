"""XML-RPC over HTTP/1.1 on asyncio: values as XML, a server, and a client call.

Received data is limited in bytes, depth, count and time. What has come of all requests and answers is limited together;
a length that is only claimed costs nothing. Document types and entities are refused.
"""

from __future__ import annotations

import asyncio
import base64
import binascii
import re
from collections.abc import Awaitable, Callable
from contextlib import suppress
from typing import Any
from urllib.parse import urlsplit
from xml.parsers import expat

from slidectl.errors import Refused, SlidectlError, TimedOut, cut
from slidectl.extensions.gateways.strangers import Strangers, forbid
from slidectl.wire.bounds import HeldBytes, HeldShare

LONGEST_BODY = 16 * 1024 * 1024
DEEPEST = 64
"""The maximum nesting of arrays and structs, the same as for parameters."""
MOST_VALUES = 100_000
MOST_CONNECTIONS = 400
CALL_LIMIT_S = 10.0

_LONGEST_HEAD = 16 * 1024
_MOST_DIGITS = 12
"""The maximum number of digits of a Content-Length."""
_MOST_HELD = 4 * LONGEST_BODY
"""Limit of the bytes that have come of all requests and answers in progress."""
_PIECE = 64 * 1024
_IDLE_LIMIT_S = 600.0
_REQUEST_LIMIT_S = 20.0
"""How long a request may take from its first byte to its last, and its answer to be read."""
_SPARE_S = 1.0
"""A connection that waits for its client for this long may be closed in favour of a new one."""
_HELD = HeldBytes(_MOST_HELD)

_INTEGERS = ("i4", "int", "i8")
_SCALARS = (*_INTEGERS, "boolean", "double", "string", "dateTime.iso8601", "base64", "nil")
_PARENTS: dict[str, tuple[str, ...]] = {
    "methodCall": ("",),
    "methodResponse": ("",),
    "methodName": ("methodCall",),
    "params": ("methodCall", "methodResponse"),
    "fault": ("methodResponse",),
    "param": ("params",),
    "value": ("param", "data", "member", "fault"),
    "member": ("struct",),
    "name": ("member",),
    "data": ("array",),
    "struct": ("value",),
    "array": ("value",),
    **dict.fromkeys(_SCALARS, ("value",)),
}
_NO_CHARACTER = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
"""Characters that XML cannot represent."""


class BadXmlRpc(SlidectlError):
    """Bytes that are not XML-RPC, or exceed a limit."""


class XmlRpcFault(SlidectlError):
    """An XML-RPC fault, in an own or a received answer."""

    def __init__(self, code: int, text: str) -> None:
        super().__init__(text)
        self.code = code


class DateTime(str):
    """A dateTime.iso8601 as its original text."""

    __slots__ = ()


# --- values as XML --------------------------------------------------------------------------------------------------


def call_xml(method: str, arguments: tuple[Any, ...]) -> bytes:
    """Encode a methodCall."""
    name, params = _escaped(method), _params(arguments)
    return f"<?xml version='1.0'?>\n<methodCall><methodName>{name}</methodName>{params}</methodCall>\n".encode()


def response_xml(value: Any) -> bytes:
    """Encode a methodResponse with one value."""
    return f"<?xml version='1.0'?>\n<methodResponse>{_params((value,))}</methodResponse>\n".encode()


def fault_xml(fault: XmlRpcFault) -> bytes:
    """Encode a fault."""
    value = _value({"faultCode": fault.code, "faultString": fault.message})
    return f"<?xml version='1.0'?>\n<methodResponse><fault>{value}</fault></methodResponse>\n".encode()


def _params(values: tuple[Any, ...]) -> str:
    return f"<params>{''.join(f'<param>{_value(value)}</param>' for value in values)}</params>"


def _value(value: Any) -> str:
    if isinstance(value, bool):
        content = f"<boolean>{value:d}</boolean>"
    elif isinstance(value, int):
        kind = "int" if -(2**31) <= value < 2**31 else "i8"  # Python's clients support i8; roscpp has no such integers
        content = f"<{kind}>{value}</{kind}>"
    elif isinstance(value, float):
        content = f"<double>{value!r}</double>"
    elif isinstance(value, DateTime):
        content = f"<dateTime.iso8601>{_escaped(value)}</dateTime.iso8601>"
    elif isinstance(value, str):
        content = f"<string>{_escaped(value)}</string>"
    elif isinstance(value, bytes):
        content = f"<base64>{base64.b64encode(value).decode()}</base64>"
    elif isinstance(value, dict):
        members = (f"<member><name>{_escaped(str(k))}</name>{_value(v)}</member>" for k, v in value.items())
        content = f"<struct>{''.join(members)}</struct>"
    elif isinstance(value, list | tuple):
        content = f"<array><data>{''.join(map(_value, value))}</data></array>"
    else:
        content = "<nil/>"
    return f"<value>{content}</value>"


def _escaped(text: str) -> str:
    """Escape text for XML. Characters that XML cannot represent become U+FFFD."""
    text = text.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;").replace("\r", "&#13;")
    return _NO_CHARACTER.sub("\N{REPLACEMENT CHARACTER}", text)


def read_call(body: bytes) -> tuple[str, list[Any]]:
    """Decode a methodCall: method and arguments. Raises BadXmlRpc."""
    kind, content = _Reader().read(body)
    if kind != "methodCall":
        raise BadXmlRpc(f"expected a methodCall, got a {kind}")
    method = [value for tag, value in content if tag == "methodName"]
    params = [value for tag, value in content if tag == "params"]
    if len(method) != 1 or len(params) > 1:
        raise BadXmlRpc("a methodCall has one methodName, and params once at most")
    return method[0], params[0] if params else []


def read_response(body: bytes) -> Any:
    """Decode a methodResponse. Raises XmlRpcFault for a fault, BadXmlRpc."""
    kind, content = _Reader().read(body)
    if kind != "methodResponse" or len(content) != 1:
        raise BadXmlRpc(f"expected a methodResponse with one value, got a {kind}")
    tag, value = content[0]
    if tag == "fault":
        known = value if isinstance(value, dict) else {}
        code = known.get("faultCode")
        raise XmlRpcFault(code if isinstance(code, int) else 0, cut(str(known.get("faultString", value))))
    if len(value) != 1:
        raise BadXmlRpc(f"a response has one value, this one has {len(value)}")
    return value[0]


class _Reader:
    """Parses one document. A stack frame is an open element: its tag, the elements that ended in it, and its text."""

    def __init__(self) -> None:
        self._stack: list[tuple[str, list[tuple[str, Any]], list[str]]] = [("", [], [])]
        self._values = 0
        self._depth = 0

    def read(self, body: bytes) -> tuple[str, Any]:
        parser = expat.ParserCreate()
        parser.buffer_text = True
        parser.StartElementHandler = self._start
        parser.EndElementHandler = self._end
        parser.CharacterDataHandler = self._text
        parser.StartDoctypeDeclHandler = self._refuse_document_type
        try:
            parser.Parse(body, True)
        except (expat.ExpatError, ValueError, LookupError) as error:  # also: numbers, base64, encodings
            raise BadXmlRpc(f"this is not XML-RPC: {error}") from None
        return self._stack[0][1][0]

    def _refuse_document_type(self, *_: Any) -> None:
        raise BadXmlRpc("a document type (and its entities) has no place in XML-RPC")

    def _start(self, tag: str, _: dict[str, str]) -> None:
        parent = self._stack[-1][0]
        if parent not in _PARENTS.get(tag, ()):
            raise BadXmlRpc(f"<{cut(tag, 80)}> is not expected in <{parent}>")
        if tag == "value":
            self._values += 1
            if self._values > MOST_VALUES:
                raise BadXmlRpc(f"more than {MOST_VALUES} values")
        elif tag in ("struct", "array"):
            self._depth += 1
            if self._depth > DEEPEST:
                raise BadXmlRpc(f"values are nested deeper than {DEEPEST} levels")
        self._stack.append((tag, [], []))

    def _text(self, text: str) -> None:
        self._stack[-1][2].append(text)

    def _end(self, tag: str) -> None:
        _, content, pieces = self._stack.pop()
        text = "".join(pieces)
        if tag in ("struct", "array"):
            self._depth -= 1
        if tag in ("methodCall", "methodResponse"):
            value: Any = content
        elif tag in ("params", "data"):
            value = [below for _, below in content]
        elif tag == "value":
            value = _only(tag, content) if content else text
        elif tag in ("param", "fault", "array"):
            value = _only(tag, content)
        elif tag == "struct":
            value = dict(below for _, below in content)
        elif tag == "member":
            if [kind for kind, _ in content] != ["name", "value"]:
                raise BadXmlRpc("a member has a name and a value")
            value = (content[0][1], content[1][1])
        else:
            value = _scalar(tag, text)
        self._stack[-1][1].append((tag, value))


def _only(tag: str, content: list[tuple[str, Any]]) -> Any:
    if len(content) != 1:
        raise BadXmlRpc(f"<{tag}> has one element in it, this one has {len(content)}")
    return content[0][1]


def _scalar(tag: str, text: str) -> Any:
    """Convert the text of a scalar element. Raises ValueError."""
    if tag in _INTEGERS:
        number = int(text[:40])
        if not -(2**63) <= number < 2**63:
            raise ValueError(f"the integer {number} does not fit 64 bits")
        return number
    if tag == "boolean":
        if text.strip() not in ("0", "1"):
            raise ValueError(f"no boolean: {cut(text, 80)!r}")
        return text.strip() == "1"
    if tag == "double":
        return float(text)
    if tag == "base64":
        return binascii.a2b_base64(text.encode())
    if tag == "dateTime.iso8601":
        return DateTime(text.strip())
    return None if tag == "nil" else text.strip() if tag == "methodName" else text


# --- the server -----------------------------------------------------------------------------------------------------

Answer = Callable[[str, str, list[Any]], Awaitable[Any]]
"""Takes path, method and arguments; returns the value. Raises XmlRpcFault."""


class _Client:
    """A connection to the server, and whom it waits for."""

    def __init__(self, task: asyncio.Task[Any], now: float) -> None:
        self.share = _HELD.share(lambda _: self.refuse())
        self.is_refused = False
        self.is_sending = False
        """True from the first byte of a request to its last."""
        self.waits_since: float | None = now
        """The time since which the client is waited for; None while its request is carried out."""
        self._task = task

    def refuse(self) -> None:
        """End the connection, to make room."""
        self.is_refused = True
        self._task.cancel()

    def is_spare(self, now: float) -> bool:
        return self.waits_since is not None and now - self.waits_since > _SPARE_S

    def waits(self, now: float | None, is_sending: bool = False) -> None:
        self.waits_since, self.is_sending = now, is_sending


class XmlRpcServer:
    """Serves calls on one port; calls of one connection are answered in order."""

    def __init__(self, answer: Answer, any_user: bool) -> None:
        """`any_user`: connections of other users of this machine are served too."""
        self._answer = answer
        self.strangers = Strangers(any_user)
        self._server: asyncio.Server | None = None
        self._clients: dict[asyncio.Task[Any], _Client] = {}

    async def open(self, host: str, port: int) -> int:
        """Listen and return the port (a free one for 0). Raises OSError."""
        self._server = await asyncio.start_server(
            self._connected, host, port, limit=_LONGEST_HEAD, reuse_address=True, backlog=MOST_CONNECTIONS
        )
        return int(self._server.sockets[0].getsockname()[1])

    @property
    def connections(self) -> int:
        return len(self._clients)

    @property
    def held(self) -> int:
        """The bytes of all requests and answers in progress, of this process."""
        return _HELD.sum

    async def close(self) -> None:
        if self._server is not None:
            self._server.close()
        tasks = list(self._clients)
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)

    def _make_room(self, now: float) -> bool:
        """End the connection whose client is slowest. A slow sender goes before one that is idle. False: none is."""
        spare = [(task, client) for task, client in self._clients.items() if client.is_spare(now)]
        if not spare:
            return False
        task, slowest = min(spare, key=lambda one: (not one[1].is_sending, one[1].waits_since))
        del self._clients[task]
        slowest.refuse()
        return True

    async def _connected(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        task = asyncio.current_task()
        assert task is not None
        if why := self.strangers.seen(task, writer.transport):
            try:
                if not self.strangers.are_many:
                    await forbid(why, reader, writer)
            finally:
                self.strangers.gone(task)
                writer.close()
            return
        now = asyncio.get_running_loop().time
        if len(self._clients) >= MOST_CONNECTIONS and not self._make_room(now()):
            writer.close()
            return
        client = self._clients[task] = _Client(task, now())
        try:
            goes_on = True
            while goes_on:
                client.waits(now())
                async with asyncio.timeout(_IDLE_LIMIT_S):
                    first = await reader.readexactly(1)
                client.waits(now(), is_sending=True)
                async with asyncio.timeout(_REQUEST_LIMIT_S):
                    line, fields = _head(first + await reader.readuntil(b"\r\n\r\n"))
                    refusal, length = _judged(line, fields)
                    body = b"" if refusal else await _read_body(reader, length, client.share)
                client.waits(None)
                client.share.set(len(body), len(body))
                client.share.handled()
                path, _, version = line.partition(" ")[2].partition(" ")
                answer = b"" if refusal else await self._carried_out(path, body)
                client.share.set(0)
                client.waits(now())
                goes_on = not refusal and version == "HTTP/1.1" and fields.get("connection", "").lower() != "close"
                await _reply(writer, refusal or "200 OK", answer, is_last=not goes_on)
        except asyncio.CancelledError:  # the gateway ends, or others need the room
            if client.is_refused and client.is_sending:
                writer.write(_response("503 Service Unavailable", b"", is_last=True))
        except (OSError, EOFError, asyncio.LimitOverrunError, TimeoutError):
            pass  # the client disconnected, sends no HTTP or is slow
        finally:
            client.share.close()
            self._clients.pop(task, None)
            writer.close()

    async def _carried_out(self, path: str, body: bytes) -> bytes:
        try:
            method, arguments = read_call(body)
            if method == "system.multicall":
                answers, size = [], 0
                for call in _calls(arguments):
                    answers.append(await self._one_of_many(path, call))
                    size += len(response_xml(answers[-1]))
                    if size > LONGEST_BODY:
                        raise XmlRpcFault(1, f"answers of more than {LONGEST_BODY} bytes to one system.multicall")
                    await asyncio.sleep(0)  # gives other tasks a turn
                return response_xml(answers)
            return response_xml(await self._answer(path, method, arguments))
        except XmlRpcFault as fault:
            return fault_xml(fault)
        except BadXmlRpc as error:
            return fault_xml(XmlRpcFault(1, error.message))

    async def _one_of_many(self, path: str, call: Any) -> Any:
        """Process one call of system.multicall as Python's servers do: the value in a list, or the fault as a
        struct.
        """
        try:
            if not isinstance(call, dict) or not isinstance(call.get("methodName"), str):
                raise XmlRpcFault(1, "a call of system.multicall has a methodName and params")
            if not isinstance(params := call.get("params", []), list):
                raise XmlRpcFault(1, "the params of a call are an array")
            return [await self._answer(path, call["methodName"], params)]
        except XmlRpcFault as fault:
            return {"faultCode": fault.code, "faultString": fault.message}


def _calls(arguments: list[Any]) -> list[Any]:
    if len(arguments) != 1 or not isinstance(arguments[0], list):
        raise XmlRpcFault(1, "system.multicall takes one array of calls")
    return arguments[0]


def _head(head: bytes) -> tuple[str, dict[str, str]]:
    """The first line, and the header fields with lower-case names."""
    line, *rest = head.decode("latin-1").strip().split("\r\n")
    fields = (field.partition(":") for field in rest)
    return line, {name.strip().lower(): value.strip() for name, _, value in fields}


def _judged(line: str, fields: dict[str, str]) -> tuple[str, int]:
    """The refusal of a request, empty without one, and the length of its body."""
    text = fields.get("content-length", "")
    length = int(text) if text.isdecimal() and text.isascii() and len(text) <= _MOST_DIGITS else -1
    refusal = (
        "501 Unsupported method" if line.partition(" ")[0] != "POST"
        else "403 Forbidden" if "origin" in fields  # the page of some site in a browser; no node of ROS sends this
        else "411 Length Required" if length < 0
        else "413 Payload Too Large" if length > LONGEST_BODY
        else ""
    )  # fmt: skip
    return refusal, length


async def _read_body(reader: asyncio.StreamReader, length: int, share: HeldShare) -> bytes:
    """Read so many bytes, and count them as they come. Raises EOFError: the other side disconnected."""
    body = bytearray()
    while len(body) < length:
        piece = await reader.read(min(_PIECE, length - len(body)))
        if not piece:
            raise EOFError(f"it disconnected after {len(body)} of {length} bytes")
        body += piece
        share.set(len(body))
    return bytes(body)


def _response(status: str, body: bytes, is_last: bool) -> bytes:
    fields = f"Server: slidectl\r\nContent-type: text/xml\r\nContent-length: {len(body)}\r\n"
    last = "Connection: close\r\n" if is_last else ""
    return f"HTTP/1.1 {status}\r\n{fields}{last}\r\n".encode() + body


async def _reply(writer: asyncio.StreamWriter, status: str, body: bytes, is_last: bool) -> None:
    writer.write(_response(status, body, is_last))
    async with asyncio.timeout(_REQUEST_LIMIT_S):
        await writer.drain()


# --- the client -----------------------------------------------------------------------------------------------------


async def call(uri: str, method: str, *arguments: Any, timeout_s: float = CALL_LIMIT_S) -> Any:
    """Call the server at this URI (http://host:port/path) and return the value.

    Raises:
        Refused: no server, or no valid XML-RPC answer. XmlRpcFault: the answer is a fault. TimedOut.
    """
    host, port, path = host_port_path(uri)
    try:
        async with asyncio.timeout(timeout_s):
            return await _exchange(host, port, path, call_xml(method, arguments))
    except TimeoutError:
        raise TimedOut(f"{uri} did not answer {method} within {timeout_s:g} s") from None
    except (OSError, EOFError, UnicodeError, asyncio.LimitOverrunError) as error:
        reason = getattr(error, "strerror", None) or str(error) or type(error).__name__
        raise Refused(f"{uri} does not answer {method}: {reason}") from None
    except BadXmlRpc as error:
        raise Refused(f"{uri} answers {method} with nonsense: {error.message}") from None


def host_port_path(uri: str) -> tuple[str, int, str]:
    """Split an http:// or rosrpc:// URI. Raises Refused."""
    try:
        parts = urlsplit(uri)
        if parts.scheme not in ("http", "rosrpc") or not parts.hostname:
            raise ValueError
        return parts.hostname, parts.port or 80, parts.path or "/"
    except ValueError:
        raise Refused(f"{cut(uri, 120)!r} is not the URI of a ROS node", "write it as http://HOST:PORT") from None


async def _exchange(host: str, port: int, path: str, body: bytes) -> Any:
    reader, writer = await asyncio.open_connection(host, port, limit=_LONGEST_HEAD)
    share = _HELD.share(lambda reason: reader.set_exception(OSError(reason)))
    try:
        fields = f"Host: {host}:{port}\r\nUser-Agent: slidectl\r\nContent-Type: text/xml\r\nConnection: close\r\n"
        writer.write(f"POST {path} HTTP/1.1\r\n{fields}Content-Length: {len(body)}\r\n\r\n".encode() + body)
        line, answered = _head(await reader.readuntil(b"\r\n\r\n"))
        if not re.match(r"HTTP/1\.[01] 200\b", line):
            raise BadXmlRpc(cut(line, 120))
        text = answered.get("content-length", "")
        if text.isdecimal() and len(text) <= _MOST_DIGITS:
            length = int(text)
            answer = await _read_body(reader, length, share) if length <= LONGEST_BODY else None
        else:
            answer = await _until_end(reader, share)
        if answer is None:
            raise BadXmlRpc(f"an answer of more than {LONGEST_BODY} bytes")
        return read_response(answer)
    finally:
        share.close()
        writer.close()
        with suppress(OSError):
            await writer.wait_closed()


async def _until_end(reader: asyncio.StreamReader, share: HeldShare) -> bytes | None:
    body = bytearray()
    while piece := await reader.read(_PIECE):
        body += piece
        share.set(len(body))
        if len(body) > LONGEST_BODY:
            return None
    return bytes(body)
