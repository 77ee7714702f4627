"""Messages with random values, of any type."""

from __future__ import annotations

import math
from binascii import b2a_base64
from random import Random
from typing import Any

from slidectl import msgs
from slidectl.msgs.schema import BYTES, FLOATS, INTEGER_RANGES, SCALAR, Field
from slidectl.recording import codec

_FLOATS = (0.0, -0.5, 1.25, 3e38, math.inf, -math.inf, None)
"""All of them are the same as float32."""
_TEXTS = ("", "slider", "größer", "a\0b", "\U0001f600")


def random_message(rng: Random, type_name: str) -> msgs.Message:
    return {field.name: _field(rng, field) for field in msgs.fields(type_name)}


def _field(rng: Random, field: Field) -> Any:
    if field.array == SCALAR:
        return _one(rng, field.type)
    count = field.array or rng.choice((0, 1, 2, 5))
    if field.type in BYTES:
        return b2a_base64(rng.randbytes(count), newline=False).decode()
    return [_one(rng, field.type) for _ in range(count)]


def _one(rng: Random, kind: str) -> Any:
    if kind in FLOATS:
        value = rng.choice(_FLOATS)
        return value if value != 3e38 else 2.0**127
    if kind in INTEGER_RANGES:
        return rng.choice((*INTEGER_RANGES[kind], 0, rng.randint(*INTEGER_RANGES[kind])))
    if kind == "bool":
        return rng.random() < 0.5
    if kind == "string":
        return rng.choice(_TEXTS)
    if kind in ("time", "duration"):
        return {
            "secs": rng.choice(INTEGER_RANGES["uint32" if kind == "time" else "int32"]),
            "nsecs": rng.choice((0, 7)),
        }
    return random_message(rng, kind)


def all_types() -> list[str]:
    services = [name + part for name in msgs.service_names() for part in ("Request", "Response")]
    return msgs.type_names() + services


def oracle(type_name: str) -> codec.Codec:
    """rosbags' way with these bytes."""
    return codec.of(type_name)
