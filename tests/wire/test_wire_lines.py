"""Lines as bytes: what goes out, what comes in, and how much of it is kept."""

from __future__ import annotations

import json
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from slidectl.wire.json_lines import BadLine, LineBuffer, decode, encode

JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text(),
    lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner),
    max_leaves=20,
)


@given(st.dictionaries(st.text(), JSON))
def test_what_is_encoded_is_decoded_to_the_same(message: dict[str, object]) -> None:
    line = encode(message)
    assert line.endswith(b"\n")
    assert line.count(b"\n") == 1
    assert decode(line) == message
    # The encoder is taken from inside of json: it does what its public one does.
    assert line == (json.dumps(message, separators=(",", ":")) + "\n").encode()


def _not_json(word: str) -> float:
    raise AssertionError(f"{word} is no JSON")


@given(st.lists(st.floats()), st.text())
def test_only_numbers_that_json_has_are_written(numbers: list[float], text: str) -> None:
    expected = [None if math.isnan(number) else number for number in numbers]
    told = f'NaN "{text}" Infinity'
    line = encode({"deep": {"list": [numbers], told: told}, "pair": (math.nan, 1)})
    assert json.loads(line, parse_constant=_not_json) == {"deep": {"list": [expected], told: told}, "pair": [None, 1]}


@given(st.lists(st.binary(min_size=1).filter(lambda line: b"\n" not in line and not line.isspace())), st.data())
def test_lines_come_out_whole_however_the_bytes_arrive(lines: list[bytes], data: st.DataObject) -> None:
    stream = b"".join(line + b"\n" for line in lines) + b"unfinished"
    buffer = LineBuffer()
    while stream:
        size = data.draw(st.integers(1, len(stream)))
        buffer.feed(stream[:size])
        stream = stream[size:]
    assert list(buffer.lines) == lines
    assert buffer.unfinished == len("unfinished")


def test_a_byte_order_mark_before_a_line_does_not_count() -> None:
    assert decode(b'\xef\xbb\xbf{"op": "x"}') == {"op": "x"}


def test_blank_lines_are_nothing() -> None:
    buffer = LineBuffer()
    buffer.feed(b"\n \r\n\t\n{}\r\n")
    assert [decode(line) for line in buffer.lines] == [{}]


def test_a_line_beyond_the_limit_is_refused_and_forgotten() -> None:
    buffer = LineBuffer(longest=10)
    buffer.feed(b"0123456789\n01234")
    with pytest.raises(BadLine, match="longer than 10 bytes"):
        buffer.feed(b"567890")
    assert (list(buffer.lines), buffer.unfinished) == ([b"0123456789"], 0)


@pytest.mark.parametrize("line", [b"", b"{", b"[]", b"3", b"\xff", b"[" * 100_000, b"1" * 10_000])
def test_what_is_no_json_object_is_a_bad_line_with_its_beginning(line: bytes) -> None:
    with pytest.raises(BadLine) as failure:
        decode(line)
    assert repr(line[:60].decode(errors="replace")) in str(failure.value)
    assert len(str(failure.value)) < 300
