"""Messages with random values, of any type, and their bytes as rosbags makes them."""

from __future__ import annotations

import math
from binascii import a2b_base64, b2a_base64
from functools import cache
from random import Random
from typing import Any

import numpy as np
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from slidectl import msgs
from slidectl.msgs.schema import BYTES, FLOATS, INTEGER_RANGES, SCALAR, TIMES, Field

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


@cache
def _store(type_name: str) -> Any:
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(msgs.full_definition(type_name), type_name))
    return store


def bytes_of(type_name: str, message: msgs.Message) -> bytes:
    """rosbags' bytes of a message."""
    store = _store(type_name)

    def built(kind: str, value: Any) -> Any:
        if kind in TIMES:
            secs = (value["secs"] + 2**31) % 2**32 - 2**31  # it has both as signed
            return store.types[f"builtin_interfaces/msg/{kind.capitalize()}"](secs, value["nsecs"])
        if kind in FLOATS:
            return math.nan if value is None else value
        if kind in INTEGER_RANGES or kind in ("bool", "string"):
            return value
        return store.types[_long(kind)](*(of_field(field, value[field.name]) for field in msgs.fields(kind)))

    def of_field(field: Field, value: Any) -> Any:
        if field.array == SCALAR:
            return built(field.type, value)
        if field.type in BYTES:
            return np.frombuffer(a2b_base64(value), np.uint8)
        if field.type in FLOATS or field.type in INTEGER_RANGES or field.type == "bool":
            return np.array(value, {"byte": "int8"}.get(field.type, field.type))
        return [built(field.type, each) for each in value]

    return bytes(store.serialize_ros1(built(type_name, message), _long(type_name)))


def md5_of(type_name: str) -> str:
    """The md5 sum as rosbags computes it."""
    md5: str = _store(type_name).generate_msgdef(_long(type_name))[1]
    return md5


def _long(type_name: str) -> str:
    return type_name.replace("/", "/msg/")
