"""Seeded changes of texts and bytes: numbers become odd ones, parts are lost, doubled, swapped or cut off."""

from __future__ import annotations

import re
from random import Random

ODD_VALUES = (
    "", "0", "-1", "1e999", "-1e308", "1e-324", "nan", "inf", "1,5", "0x10", "é", "\u0000", "'", "true", "~", "[]",
    "{}", "${1/0}", "${x}", "$(arg x)", "$(find nowhere)", "$(eval 1/0)", "..", "/", "//", "world", "a/b", "%s",
    "99999999999999999999", "1 2", "0 0 0", "0 0 0 0", " ", "a" * 300,
)  # fmt: skip
PLAUSIBLE = ("0.001", "0.5", "-0.5", "2", "30", "1e-6", "1e6", "-3.14159", "0", "1e-12")
"""What passes more checks than the odd ones, and so gets further."""
_TOKEN = re.compile(r'"[^"]*"|<[^<>]*>|[A-Za-z_][\w:]*|[-+]?\d[\d.eE+-]*|\s+|.', re.DOTALL)
_NUMBER = re.compile(r"[-+]?\d[\d.eE+-]*")


def mutated_text(rng: Random, text: str) -> str:
    """The text with one to six changes."""
    tokens = _TOKEN.findall(text)
    for _ in range(rng.choice((1, 1, 1, 2, 3, 6))):
        if not tokens:
            break
        place = rng.randrange(len(tokens))
        kind = rng.randrange(8)
        if kind <= 2:
            numbers = [i for i, token in enumerate(tokens) if re.search(r"\d", token)]
            if numbers:
                place = rng.choice(numbers)
                values = ODD_VALUES if rng.random() < 0.4 else PLAUSIBLE
                number = rng.choice(values)
                tokens[place] = _NUMBER.sub(lambda _: number, tokens[place], count=rng.choice((1, 3)))  # noqa: B023
        elif kind == 3:
            tokens[place] = f'"{rng.choice(ODD_VALUES)}"' if tokens[place].startswith('"') else rng.choice(ODD_VALUES)
        elif kind == 4:
            del tokens[place : place + rng.choice((1, 1, 3, 20))]
        elif kind == 5:
            tokens[place:place] = tokens[place : place + rng.choice((1, 5, 40))]
        elif kind == 6:
            other = rng.randrange(len(tokens))
            tokens[place], tokens[other] = tokens[other], tokens[place]
        else:
            del tokens[place + 1 :]
    return "".join(tokens)


def mutated_bytes(rng: Random, content: bytes) -> bytes:
    """The bytes with one to eight changes."""
    data = bytearray(content)
    for _ in range(rng.choice((1, 2, 4, 8))):
        if not data:
            break
        place = rng.randrange(len(data))
        kind = rng.randrange(5)
        if kind == 0:
            data[place] = rng.randrange(256)
        elif kind == 1:
            data[place : place + 4] = rng.choice((b"\xff\xff\xff\xff", b"\x00\x00\xc0\x7f", b"\x00\x00\x00\x00"))
        elif kind == 2:
            del data[place : place + rng.choice((1, 4, 50))]
        elif kind == 3:
            data[place:place] = data[place : place + rng.choice((1, 4, 50))]
        else:
            del data[place:]
    return bytes(data)


def shrunk(text: str, fails: object, rounds: int = 60) -> str:
    """A shorter text that still fails (`fails(text)` is true): lines are left out while that is so."""
    assert callable(fails)
    lines, size = text.splitlines(keepends=True), 0
    size = max(1, len(lines) // 2)
    while size and rounds > 0:
        place = 0
        while place < len(lines) and rounds > 0:
            rounds -= 1
            fewer = lines[:place] + lines[place + size :]
            if fails("".join(fewer)):
                lines = fewer
            else:
                place += size
        size //= 2
    return "".join(lines)
