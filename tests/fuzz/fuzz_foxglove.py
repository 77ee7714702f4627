"""What an app may send to Foxglove's gateway: frames of its protocol, changed at random."""

from __future__ import annotations

import asyncio
import json
import struct
from contextlib import suppress
from random import Random
from typing import Any

from fuzz_mutations import mutated_bytes
from fuzz_target import ANSWER_LIMIT_S, Fault, Target
from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import ConnectionClosed
from websockets.typing import Subprotocol

from slidectl.extensions.gateways.foxglove.foxglove_frames import SUBPROTOCOLS, BadFrame, read_binary, read_text
from slidectl.extensions.gateways.foxglove.foxglove_gateway import FoxgloveGateway, FoxgloveOptions

FRAMES, READ = 200, 5000
"""Of one case: what is sent to a gateway, and what is only read."""
_END = "the end"
"""No operation: the error about it is the answer to the last frame."""
_SERVICES = ("/slidectl/status", "/rosapi/get_param", "/slidectl/resolve")
"""They change nothing."""


class FoxgloveFrames:
    """Frames, changed, to a gateway: each is carried out or answered with an error, and the next one is understood."""

    kind = "foxglove"

    def __init__(self, target: Target) -> None:
        self.target = target

    def case(self, rng: Random) -> str:
        _read(rng)
        asyncio.run(self._attack(rng))
        self.target.check()
        return "answered"

    async def _attack(self, rng: Random) -> None:
        gateway = FoxgloveGateway(FoxgloveOptions(port=0))
        address = await gateway.open()
        try:
            await gateway.attach(self.target.runtime.paths)
            async with connect(address, subprotocols=[Subprotocol(SUBPROTOCOLS[0])], max_queue=None) as app:
                frames = _frames(await _services(app))
                reading = asyncio.ensure_future(_until_the_end(app))
                for _ in range(FRAMES):
                    frame = rng.choice(frames)
                    changed = mutated_bytes(rng, frame.encode() if isinstance(frame, str) else frame)
                    await app.send(changed.decode("utf-8", "replace") if isinstance(frame, str) else changed)
                await app.send(json.dumps({"op": _END}))
                await asyncio.wait_for(reading, ANSWER_LIMIT_S)
        except (ConnectionClosed, TimeoutError) as error:
            raise Fault(f"no answer after the last frame: {error!r}") from None
        finally:
            await gateway.close()


def _read(rng: Random) -> None:
    """Frames that are read alone, which is quick."""
    frames = _frames(dict.fromkeys(_SERVICES, 1))
    for _ in range(READ):
        frame = rng.choice(frames)
        with suppress(BadFrame):
            if isinstance(frame, str):
                read_text(mutated_bytes(rng, frame.encode()).decode("utf-8", "replace"))
            else:
                read_binary(mutated_bytes(rng, frame))


async def _services(app: ClientConnection) -> dict[str, int]:
    """The ids of services, from what every app is told first."""
    while True:
        told = json.loads(await app.recv(decode=True))
        if told["op"] == "advertiseServices":
            return {each["name"]: each["id"] for each in told["services"]}


async def _until_the_end(app: ClientConnection) -> None:
    async for frame in app:
        if isinstance(frame, str) and _END in json.loads(frame).get("message", ""):
            return


def _frames(services: dict[str, int]) -> list[str | bytes]:
    """What apps send."""
    objects: list[dict[str, Any]] = [
        {"op": "subscribe", "subscriptions": [{"id": 1, "channelId": 1}, {"id": 2, "channelId": 2}]},
        {"op": "unsubscribe", "subscriptionIds": [1, 2]},
        {
            "op": "advertise",
            "channels": [{"id": 1, "topic": "/f", "encoding": "json", "schemaName": "std_msgs/Header"}],
        },
        {
            "op": "advertise",
            "channels": [{"id": 2, "topic": "/g", "encoding": "ros1", "schemaName": "rosgraph_msgs/Log"}],
        },
        {"op": "unadvertise", "channelIds": [1, 2]},
        {"op": "getParameters", "parameterNames": ["/use_sim_time", "/a"], "id": "a"},
        {"op": "setParameters", "parameters": [{"name": "/a", "value": [1.5], "type": "float64_array"}], "id": "b"},
        {"op": "setParameters", "parameters": [{"name": "/b", "value": {"c": None, "d": 1e999}}]},
        {"op": "subscribeParameterUpdates", "parameterNames": ["/a", "/b"]},
        {"op": "unsubscribeParameterUpdates", "parameterNames": ["/a"]},
        {"op": "subscribeConnectionGraph"},
        {"op": "unsubscribeConnectionGraph"},
        {"op": "fetchAsset", "uri": "package://a/b.stl", "requestId": 1},
    ]
    calls = [
        struct.pack("<BIII", 2, services[name], 1, len(encoding)) + encoding + payload
        for name in _SERVICES
        for encoding, payload in ((b"ros1", b"\1\0\0\0a\0\0\0\0"), (b"json", b'{"name": "/a"}'))
    ]
    messages = [struct.pack("<BI", 1, 1) + b'{"stamp": {"sec": 1}, "seq": 2}', struct.pack("<BI", 1, 2) + bytes(40)]
    return [*map(json.dumps, objects), *calls, *messages]
