"""What a node of ROS 1 may send over XML-RPC: documents and HTTP requests, changed at random, with any values."""

from __future__ import annotations

import asyncio
from random import Random
from typing import Any

from fuzz_mutations import ODD_VALUES, mutated_bytes, mutated_text
from fuzz_target import Fault, Target

from slidectl.extensions.gateways.ros1 import xmlrpc
from slidectl.extensions.gateways.ros1.api_calls import Api
from slidectl.extensions.gateways.ros1.master import Master
from slidectl.extensions.gateways.ros1.native_graph import NativeGraph

DOCUMENTS = 100
"""Of one case."""
_REQUESTS = 3
_ANSWER_LIMIT_S = 20.0
_METHODS = ("registerService", "unregisterService", "registerSubscriber", "unregisterSubscriber", "registerPublisher",
            "unregisterPublisher", "lookupNode", "lookupService", "getPublishedTopics", "getTopicTypes",
            "getSystemState", "getUri", "getPid", "shutdown", "fly", "system.multicall")  # fmt: skip
_WORDS = ("/a", "/b/c", "~x", "y", "*", "std_msgs/Float64", "http://h:1/", "rosrpc://h:2", *ODD_VALUES)


class _DiscardingReader:
    """Carries no data, and knows nobody."""

    def __getattr__(self, _: str) -> Any:
        return lambda *_: False


class XmlRpcCalls:
    """Each document is read or refused, each call answered with code, message and value, or a fault."""

    kind = "xmlrpc"

    def __init__(self, target: Target) -> None:
        del target

    def case(self, rng: Random) -> str:
        asyncio.run(self._calls(rng))
        return "answered or refused"

    async def _calls(self, rng: Random) -> None:
        nobody: Any = _DiscardingReader()
        api = Api()
        Master(NativeGraph(lambda node: f"http://h:1{node}"), nobody, nobody).add_methods(api)

        async def answer(_: str, method: str, arguments: list[Any]) -> Any:
            answered = await api.answer(method, arguments)
            if len(answered) != 3 or answered[0] not in (-1, 0, 1) or not isinstance(answered[1], str):
                raise Fault(f"{method}{arguments} is answered with {answered}")
            return answered

        for _ in range(DOCUMENTS):
            await self._document(rng, answer)
        server = xmlrpc.XmlRpcServer(answer, any_user=False)
        port = await server.open("127.0.0.1", 0)
        try:
            for _ in range(_REQUESTS):
                async with asyncio.timeout(_ANSWER_LIMIT_S):
                    await self._request(rng, port)
        finally:
            await server.close()
        if server.held or server.connections:
            raise Fault(f"{server.held} bytes and {server.connections} connections are still counted")

    async def _document(self, rng: Random, answer: xmlrpc.Answer) -> None:
        body = self._body(rng)
        try:
            method, arguments = xmlrpc.read_call(body)
        except xmlrpc.BadXmlRpc:
            return
        try:
            written = xmlrpc.response_xml(await answer("/", method, arguments))
        except xmlrpc.XmlRpcFault as fault:
            written = xmlrpc.fault_xml(fault)
        try:
            xmlrpc.read_response(written)
        except xmlrpc.XmlRpcFault:
            pass
        except xmlrpc.BadXmlRpc as error:
            raise Fault(f"what was answered to {body!r} cannot be read: {written!r}: {error}") from None

    async def _request(self, rng: Random, port: int) -> None:
        body = self._body(rng)
        head = f"POST / HTTP/1.1\r\nHost: x\r\nContent-Length: {len(body)}\r\n\r\n".encode()
        reader, writer = await asyncio.open_connection("127.0.0.1", port)
        try:
            writer.write((mutated_bytes(rng, head) if rng.random() < 0.7 else head) + body)
            writer.write_eof()
            await reader.read()
        except ConnectionError:
            pass  # it hung up in the middle, as it may
        finally:
            writer.close()

    def _body(self, rng: Random) -> bytes:
        arguments = [self._value(rng, 0) for _ in range(rng.choice((0, 1, 2, 3, 4, 5)))]
        if arguments and rng.random() < 0.8:
            arguments[0] = "/caller"
        text = xmlrpc.call_xml(rng.choice(_METHODS), tuple(arguments)).decode()
        kind = rng.random()
        if kind < 0.4:
            return mutated_text(rng, text).encode("utf-8", "replace")
        return mutated_bytes(rng, text.encode()) if kind < 0.8 else text.encode()

    def _value(self, rng: Random, depth: int) -> Any:
        kind = rng.randrange(8 if depth < 4 else 6)
        if kind < 3:
            return rng.choice(_WORDS)
        if kind < 6:
            return rng.choice((0, -1, 2**40, 1.5, True, None, b"\x00\xff", xmlrpc.DateTime("20200101T00:00:00")))
        if kind == 6:
            return [self._value(rng, depth + 1) for _ in range(rng.randrange(4))]
        return {rng.choice(_WORDS): self._value(rng, depth + 1) for _ in range(rng.randrange(4))}
