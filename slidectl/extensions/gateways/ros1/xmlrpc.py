"""XML-RPC over HTTP/1.1 on asyncio: a server, and a client call, with the values as Python's `xmlrpc.client` has them.

Received data is limited in bytes, depth, count and time. What has come of all requests and answers is limited together;
a length that is only claimed costs nothing. Document types and entities are refused.
"""

from __future__ import annotations

import asyncio
import re
from collections.abc import Awaitable, Callable
from contextlib import suppress
from typing import Any
from urllib.parse import urlsplit
from xml.parsers import expat
from xmlrpc.client import Fault, Marshaller, ResponseError, Unmarshaller

from slidectl.errors import Refused, SlidectlError, TimedOut, cut
from slidectl.extensions.gateways.ros1.counted_streams import CountedReader, GivenUp, connect, listen
from slidectl.extensions.gateways.strangers import Strangers, forbid
from slidectl.wire.bounds import HeldBytes

LONGEST_BODY = 16 * 1024 * 1024
DEEPEST = 64
"""The maximum nesting of arrays and structs, the same as for parameters."""
MOST_VALUES = 100_000
MOST_CONNECTIONS = 400
CALL_LIMIT_S = 10.0

_LONGEST_HEAD = 16 * 1024
_MOST_DIGITS = 12
"""The maximum number of digits of a Content-Length."""
_IDLE_LIMIT_S = 600.0
_REQUEST_LIMIT_S = 20.0
"""How long a request may take from its first byte to its last, and its answer to be read."""
_SPARE_S = 1.0
"""A connection that waits for its client for this long may be closed in favour of a new one."""
_HELD = HeldBytes(4 * LONGEST_BODY)
"""The bytes that have come of all requests and answers in progress."""

_INTEGERS = ("i4", "int", "i8")
_NO_CHARACTER = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
"""Characters that XML cannot represent."""


class BadXmlRpc(SlidectlError):
    """Bytes that are no XML-RPC, or exceed a limit."""


class XmlRpcFault(SlidectlError):
    """An XML-RPC fault, in an own or a received answer."""

    def __init__(self, code: int, text: str) -> None:
        super().__init__(text)
        self.code = code


# --- values as XML --------------------------------------------------------------------------------------------------


def call_xml(method: str, arguments: tuple[Any, ...]) -> bytes:
    """Encode a methodCall."""
    return _document(f"<methodCall><methodName>{_escaped(method)}</methodName>", arguments, "</methodCall>")


def response_xml(value: Any) -> bytes:
    """Encode a methodResponse with one value."""
    return _document("<methodResponse>", (value,), "</methodResponse>")


def fault_xml(fault: XmlRpcFault) -> bytes:
    """Encode a fault."""
    return _document("<methodResponse>", Fault(fault.code, fault.message), "</methodResponse>")


def _document(begin: str, values: Any, end: str) -> bytes:
    return f"<?xml version='1.0'?>\n{begin}{_Writer(allow_none=True).dumps(values)}{end}\n".encode()


def _escaped(text: str) -> str:
    """Escape text for XML. Characters that XML cannot represent become U+FFFD."""
    text = text.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;").replace("\r", "&#13;")
    return _NO_CHARACTER.sub("\N{REPLACEMENT CHARACTER}", text)


class _Writer(Marshaller):
    """Python's writer, with all integers and all texts. It has no method for an extension: `dispatch` is its table."""

    def dump_integer(self, value: int, write: Callable[[str], object]) -> None:
        kind = "int" if -(2**31) <= value < 2**31 else "i8"  # Python's clients support i8; roscpp has no such integers
        write(f"<value><{kind}>{value}</{kind}></value>")

    dispatch: Any = {
        **Marshaller.dispatch,
        int: dump_integer,
        str: lambda self, value, write: self.dump_unicode(value, write, _escaped),
        dict: lambda self, value, write: self.dump_struct(value, write, _escaped),
    }


def read_call(body: bytes) -> tuple[str, list[Any]]:
    """Decode a methodCall: method and arguments. Raises BadXmlRpc."""
    reader = _Reader()
    try:
        arguments = reader.read(body)
    except Fault:
        raise BadXmlRpc("expected a methodCall, got a fault") from None
    method = reader.getmethodname()
    if method is None:
        raise BadXmlRpc("expected a methodCall with a methodName")
    return method.strip(), list(arguments)


def read_response(body: bytes) -> Any:
    """Decode a methodResponse. Raises XmlRpcFault for a fault, BadXmlRpc."""
    try:
        values = _Reader().read(body)
    except Fault as fault:
        code: Any = fault.faultCode
        raise XmlRpcFault(code if isinstance(code, int) else 0, cut(str(fault.faultString))) from None
    if len(values) != 1:
        raise BadXmlRpc(f"a response has one value, this one has {len(values)}")
    return values[0]


class _Reader(Unmarshaller):
    """Python's reader, with bounds, and without the types that ROS does not have. Dates become their text."""

    def __init__(self) -> None:
        super().__init__(use_builtin_types=True)
        self._values = 0
        self._depth = 0

    def read(self, body: bytes) -> tuple[Any, ...]:
        """The values of a document. Raises Fault, BadXmlRpc."""
        parser = expat.ParserCreate()
        parser.buffer_text = True
        parser.StartElementHandler = self.start
        parser.EndElementHandler = self.end
        parser.CharacterDataHandler = self.data
        parser.StartDoctypeDeclHandler = self._refuse_document_type
        self.xml("", None)  # texts come decoded
        try:
            parser.Parse(body, True)
            return self.close()
        except (Fault, BadXmlRpc):
            raise
        except (expat.ExpatError, ResponseError, ValueError, TypeError, LookupError, AttributeError) as error:
            # Python's reader checks no structure: it fails in one of these ways.
            raise BadXmlRpc(f"invalid XML-RPC: {str(error) or type(error).__name__}") from None

    def _refuse_document_type(self, *_: Any) -> None:
        raise BadXmlRpc("a document type (and its entities) has no place in XML-RPC")

    def start(self, tag: str, attrs: dict[str, str]) -> None:
        super().start(tag, attrs)
        if tag == "value":
            self._values += 1
            if self._values > MOST_VALUES:
                raise BadXmlRpc(f"more than {MOST_VALUES} values")
        elif tag in ("struct", "array"):
            self._depth += 1
            if self._depth > DEEPEST:
                raise BadXmlRpc(f"values are nested deeper than {DEEPEST} levels")

    def end(self, tag: str, *_: Any) -> None:
        if tag in ("struct", "array"):
            self._depth -= 1
        super().end(tag)

    def end_integer(self, data: str) -> None:
        number = int(data[:40])
        if not -(2**63) <= number < 2**63:
            raise ValueError(f"the integer {number} does not fit 64 bits")
        self.end_int(data)

    dispatch: Any = {
        **{tag: Unmarshaller.dispatch[tag] for tag in (
            "array", "base64", "boolean", "double", "fault", "methodName", "name", "nil", "params", "string", "struct",
            "value",
        )},
        **dict.fromkeys(_INTEGERS, end_integer),
        "dateTime.iso8601": Unmarshaller.dispatch["string"],
    }  # fmt: skip


# --- the server -----------------------------------------------------------------------------------------------------

Answer = Callable[[str, str, list[Any]], Awaitable[Any]]
"""Takes path, method and arguments; returns the value. Raises XmlRpcFault."""


class _Client:
    """A connection to the server, and whom it waits for."""

    def __init__(self, now: float) -> None:
        self.is_sending = False
        """True from the first byte of a request to its last."""
        self.waits_since: float | None = now
        """The time since which the client is waited for; None while its request is carried out."""

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
        self._server = await listen(host, port, _HELD, self._serve)
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
        spare = [
            (not client.is_sending, since, task)
            for task, client in self._clients.items()
            if (since := client.waits_since) is not None and now - since > _SPARE_S
        ]
        if spare:
            _, _, slowest = min(spare, key=lambda one: one[:2])
            del self._clients[slowest]
            slowest.cancel()
        return bool(spare)

    async def _serve(self, reader: CountedReader, writer: asyncio.StreamWriter) -> None:
        task = asyncio.current_task()
        assert task is not None
        try:
            if why := self.strangers.check(task, writer.transport):
                if not self.strangers.are_many:
                    await forbid(why, reader, writer)
                return
            now = asyncio.get_running_loop().time()
            if len(self._clients) >= MOST_CONNECTIONS and not self._make_room(now):
                return
            client = self._clients[task] = _Client(now)
            reader.on_end = lambda error: task.cancel() if isinstance(error, GivenUp) else None
            try:
                while await self._serve_request(client, reader, writer):
                    pass
            except (asyncio.CancelledError, GivenUp):  # the gateway ends, or others need the room
                if client.is_sending:
                    writer.write(_response("503 Service Unavailable", b"", is_last=True))
            except (OSError, EOFError, asyncio.LimitOverrunError, TimeoutError):
                pass  # the client disconnected, sends no HTTP or is slow
        finally:
            self.strangers.remove(task)
            self._clients.pop(task, None)
            reader.close()
            writer.close()

    async def _serve_request(self, client: _Client, reader: CountedReader, writer: asyncio.StreamWriter) -> bool:
        """Answer the next request. Returns False when the connection ends with it."""
        now = asyncio.get_running_loop().time
        client.waits(now())
        async with asyncio.timeout(_IDLE_LIMIT_S):
            first = await reader.readexactly(1)
        client.waits(now(), is_sending=True)
        async with asyncio.timeout(_REQUEST_LIMIT_S):
            line, fields = await _read_head(reader, first)
            refusal, length = _judged(line, fields)
            body = b"" if refusal else await reader.readexactly(length)
        client.waits(None)
        path, _, version = line.partition(" ")[2].partition(" ")
        answer = b"" if refusal else await self._carried_out(path, body)
        reader.handled()
        client.waits(now())
        goes_on = not refusal and version == "HTTP/1.1" and fields.get("connection", "").lower() != "close"
        writer.write(_response(refusal or "200 OK", answer, is_last=not goes_on))
        async with asyncio.timeout(_REQUEST_LIMIT_S):
            await writer.drain()
        return goes_on

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


async def _read_head(reader: CountedReader, first: bytes = b"") -> tuple[str, dict[str, str]]:
    """Read the first line, and the header fields with lower-case names. Raises as `readuntil`."""
    head = first + await reader.readuntil(b"\r\n\r\n")
    if len(head) > _LONGEST_HEAD:
        raise asyncio.LimitOverrunError("the head is too long", len(head))
    line, *rest = head.decode("latin-1").strip().split("\r\n")
    fields = (field.partition(":") for field in rest)
    return line, {name.strip().lower(): value.strip() for name, _, value in fields}


def _judged(line: str, fields: dict[str, str]) -> tuple[str, int]:
    """The refusal of a request, empty without one, and the length of its body."""
    length = _length(fields)
    refusal = (
        "501 Unsupported method" if line.partition(" ")[0] != "POST"
        else "403 Forbidden" if "origin" in fields  # the page of some site in a browser; no node of ROS sends this
        else "411 Length Required" if length < 0
        else "413 Payload Too Large" if length > LONGEST_BODY
        else ""
    )  # fmt: skip
    return refusal, length


def _length(fields: dict[str, str]) -> int:
    """The length of a body; -1 without a valid one."""
    text = fields.get("content-length", "")
    return int(text) if text.isdecimal() and text.isascii() and len(text) <= _MOST_DIGITS else -1


def _response(status: str, body: bytes, is_last: bool) -> bytes:
    fields = f"Server: slidectl\r\nContent-type: text/xml\r\nContent-length: {len(body)}\r\n"
    last = "Connection: close\r\n" if is_last else ""
    return f"HTTP/1.1 {status}\r\n{fields}{last}\r\n".encode() + body


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
        raise Refused(f"{uri} sent an invalid answer to {method}: {error.message}") from None


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
    reader, writer = await connect(host, port, _HELD)
    try:
        fields = f"Host: {host}:{port}\r\nUser-Agent: slidectl\r\nContent-Type: text/xml\r\nConnection: close\r\n"
        writer.write(f"POST {path} HTTP/1.1\r\n{fields}Content-Length: {len(body)}\r\n\r\n".encode() + body)
        line, answered = await _read_head(reader)
        if not re.match(r"HTTP/1\.[01] 200\b", line):
            raise BadXmlRpc(cut(line, 120))
        length = _length(answered)
        if length > LONGEST_BODY:
            raise BadXmlRpc(f"an answer of more than {LONGEST_BODY} bytes")
        return read_response(await (reader.readexactly(length) if length >= 0 else _until_end(reader)))
    finally:
        reader.close()
        writer.close()
        with suppress(OSError):
            await writer.wait_closed()


async def _until_end(reader: CountedReader) -> bytes:
    try:
        await reader.readexactly(LONGEST_BODY + 1)
    except asyncio.IncompleteReadError as error:
        return error.partial
    raise BadXmlRpc(f"an answer of more than {LONGEST_BODY} bytes")
