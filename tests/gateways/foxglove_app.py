"""An app that speaks Foxglove's protocol, for tests: every frame is kept in the order in which it came."""

from __future__ import annotations

import json
import struct
from types import TracebackType
from typing import Any

from websockets.sync.client import connect
from websockets.typing import Subprotocol

from slidectl import msgs
from slidectl.extensions.gateways.ros1.ros1_types import ros1_type

LIMIT_S = 30.0
Message = dict[str, Any]


class FoxgloveApp:
    """A connection. What is waited for is taken out of what has come; the rest stays for others to wait for."""

    def __init__(self, address: str, subprotocol: str = "foxglove.sdk.v1", **options: Any) -> None:
        self.websocket = connect(
            address,
            subprotocols=[Subprotocol(subprotocol)],
            max_size=None,
            compression=None,
            close_timeout=0.5,  # it does not read what is unread still
            **options,
        )
        self._kept: list[Message] = []
        self.channels: dict[str, Message] = {}
        self.services: dict[str, Message] = {}
        self._serial = 0

    def __enter__(self) -> FoxgloveApp:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.websocket.close()

    def send(self, op: str, **values: Any) -> None:
        self.websocket.send(json.dumps({"op": op, **values}))

    def receive(self, timeout_s: float = LIMIT_S) -> Message:
        """The next frame as an object; binary ones are `message`, `time`, `response` or `asset`."""
        frame = self.websocket.recv(timeout=timeout_s)
        message = json.loads(frame) if isinstance(frame, str) else _binary(frame)
        if message["op"] == "advertise":
            self.channels |= {each["topic"]: each for each in message["channels"]}
        elif message["op"] == "unadvertise":
            self.channels = {k: each for k, each in self.channels.items() if each["id"] not in message["channelIds"]}
        elif message["op"] == "advertiseServices":
            self.services |= {each["name"]: each for each in message["services"]}
        elif message["op"] == "unadvertiseServices":
            self.services = {k: each for k, each in self.services.items() if each["id"] not in message["serviceIds"]}
        return message

    def wait(self, op: str, **values: Any) -> Message:
        """The first frame of that operation with these values, of those that came or come."""

        def fits(message: Message) -> bool:
            return message["op"] == op and all(message.get(key) == value for key, value in values.items())

        for index, kept in enumerate(self._kept):
            if fits(kept):
                return self._kept.pop(index)
        while not fits(message := self.receive()):
            self._kept.append(message)
        return message

    def channel(self, topic: str) -> Message:
        """The channel of a topic, when it is there."""
        while topic not in self.channels:
            self._kept.append(self.receive())
        return self.channels[topic]

    def service(self, name: str) -> Message:
        while name not in self.services:
            self._kept.append(self.receive())
        return self.services[name]

    def subscribe(self, topic: str) -> int:
        self._serial += 1
        self.send("subscribe", subscriptions=[{"id": self._serial, "channelId": self.channel(topic)["id"]}])
        return self._serial

    def message(self, topic: str, subscription: int) -> Message:
        """The next message of a subscription, decoded."""
        data = self.wait("message", subscription=subscription)["data"]
        return ros1_type(self.channel(topic)["schemaName"]).unpack(data)

    def advertise(self, topic: str, type: str, encoding: str = "ros1") -> int:
        self._serial += 1
        self.send(
            "advertise", channels=[{"id": self._serial, "topic": topic, "encoding": encoding, "schemaName": type}]
        )
        return self._serial

    def publish(self, channel: int, payload: bytes) -> None:
        self.websocket.send(struct.pack("<BI", 1, channel) + payload)

    def begin_call(self, name: str, payload: bytes, encoding: str = "ros1") -> int:
        self._serial += 1
        head = struct.pack("<BIII", 2, self.service(name)["id"], self._serial, len(encoding))
        self.websocket.send(head + encoding.encode() + payload)
        return self._serial

    def call(self, name: str, request: Message | None = None) -> Message:
        """The response of a service; an AssertionError with the text of its failure."""
        service = self.service(name)
        kind = service["request"]["schemaName"]
        payload = ros1_type(kind).pack(msgs.check(kind, request or {}))
        call = self.begin_call(name, payload)
        while True:
            message = self.receive()
            if message["op"] == "serviceCallFailure" and message["callId"] == call:
                raise AssertionError(message["message"])
            if message["op"] == "response" and message["call"] == call:
                return ros1_type(service["response"]["schemaName"]).unpack(message["data"])
            self._kept.append(message)

    def fetch(self, uri: str) -> Message:
        self._serial += 1
        self.send("fetchAsset", uri=uri, requestId=self._serial)
        return self.wait("asset", request=self._serial)

    def error(self) -> str:
        """The text of the next error."""
        return str(self.wait("status", level=2)["message"])


def _binary(frame: bytes) -> Message:
    operation = frame[0]
    if operation == 1:
        subscription, time_ns = struct.unpack_from("<IQ", frame, 1)
        return {"op": "message", "subscription": subscription, "time_ns": time_ns, "data": frame[13:]}
    if operation == 2:
        return {"op": "time", "time_ns": struct.unpack_from("<Q", frame, 1)[0]}
    if operation == 3:
        service, call, length = struct.unpack_from("<III", frame, 1)
        encoding, data = frame[13 : 13 + length].decode(), frame[13 + length :]
        return {"op": "response", "service": service, "call": call, "encoding": encoding, "data": data}
    assert operation == 4
    request, status, length = struct.unpack_from("<IBI", frame, 1)
    error, data = frame[10 : 10 + length].decode(), frame[10 + length :]
    return {"op": "asset", "request": request, "is_there": status == 0, "error": error, "data": data}
