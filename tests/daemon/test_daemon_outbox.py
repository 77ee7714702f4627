"""The outbox: order, bounds, and the honest count of what was given up."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

from hypothesis import given
from hypothesis import strategies as st

from slidectl.daemon.outbox import MOST_BYTES, Outbox, Share


def report(share: Share) -> bytes:
    return b"<%d of %s>" % (share.dropped, share.topic.encode())


def test_lines_leave_in_the_order_in_which_they_came() -> None:
    outbox, share = Outbox(report), Share("t", 10)
    outbox.put(b"1")
    outbox.put_in(share, b"2")
    outbox.put(b"3")
    assert outbox.take(100) == b"123"
    assert not outbox


def test_a_piece_is_no_larger_than_asked_by_more_than_a_line() -> None:
    outbox = Outbox(report)
    for _ in range(5):
        outbox.put(b"abc")
    assert (outbox.take(4), outbox.take(1), outbox.take(100)) == (b"abcabc", b"abc", b"abcabc")


def test_a_full_share_keeps_its_newest_and_reports_once_where_the_gap_is() -> None:
    outbox, share = Outbox(report), Share("t", 2)
    outbox.put(b"answer")
    for number in range(5):
        outbox.put_in(share, b"%d" % number)
    outbox.put(b"end")
    assert outbox.take(100) == b"answer<3 of t>34end"
    outbox.put_in(share, b"5")
    assert outbox.take(100) == b"5"


def test_shares_do_not_take_room_from_each_other() -> None:
    outbox, small, large = Outbox(report), Share("small", 1), Share("large", 3)
    for number in range(3):
        outbox.put_in(small, b"s%d" % number)
        outbox.put_in(large, b"l%d" % number)
    assert outbox.take(100) == b"l0l1<2 of small>s2l2"


def test_large_messages_are_bounded_by_their_bytes_and_the_newest_is_kept() -> None:
    outbox, share = Outbox(report), Share("t", 1000)
    for _ in range(5):
        outbox.put_in(share, b"x" * (MOST_BYTES // 2))
    outbox.put_in(share, b"y" * (MOST_BYTES + 1))
    assert (len(share.lines), share.dropped) == (1, 5)
    assert outbox.take(1) == b"<5 of t>" + b"y" * (MOST_BYTES + 1)


class Lines:
    """Makes lines, and counts how many were made."""

    def __init__(self, length: int = 4) -> None:
        self.length = length
        self.made = 0

    def __call__(self, number: int) -> Callable[[], bytes]:
        def make() -> bytes:
            self.made += 1
            return b"%d" % number + b" " * (self.length - len(b"%d" % number))

        return make


def test_lines_that_are_given_up_are_not_made() -> None:
    outbox, share, lines = Outbox(report), Share("t", 10), Lines()
    for number in range(1600):
        outbox.put_in(share, lines(number))
    assert lines.made == 100
    assert outbox.take(1000) == b"<1590 of t>" + b"".join(b"%d" % number for number in range(1590, 1600))
    assert lines.made < 111


def test_lines_that_are_not_made_are_bounded_by_the_memory_that_they_take() -> None:
    outbox, share, lines = Outbox(report), Share("t", 1000), Lines(10_000)
    for number in range(1000):
        outbox.put_in(share, lines(number))
    assert len(share.lines) < MOST_BYTES / (2 * lines.length)
    lines.length = MOST_BYTES // 4
    for number in range(40):
        outbox.put_in(share, lines(number))
    assert len(share.lines) == 1
    sent = outbox.take(1)
    assert sent.endswith(b"39" + b" " * (lines.length - 2))
    assert share.size == 0


def test_a_forgotten_share_sends_nothing_more() -> None:
    outbox, share = Outbox(report), Share("t", 2)
    for number in range(5):
        outbox.put_in(share, b"%d" % number)
    outbox.put(b"answer")
    outbox.forget(share)
    assert outbox.take(100) == b"answer"


def test_bytes_that_cannot_be_dropped_are_counted() -> None:
    outbox, share = Outbox(report), Share("t", 2)
    outbox.put(b"12345")
    outbox.put_in(share, b"678")
    assert outbox.unbounded == 5
    outbox.take(100)
    assert outbox.unbounded == 0


@given(st.lists(st.tuples(st.sampled_from("abc-"), st.integers(1, 600)), max_size=10))
def test_any_history_gives_what_a_plain_queue_per_share_would_keep(history: list[tuple[str, int]]) -> None:
    outbox = Outbox(report)
    shares = {name: Share(name, limit) for name, limit in (("a", 1), ("b", 7), ("c", 300))}
    kept: dict[str, deque[bytes]] = {name: deque(maxlen=share.limit) for name, share in shares.items()}
    kept["-"] = deque()
    serial = 0
    for name, count in history:
        for _ in range(count):
            serial += 1
            line = b"%s%05d" % (name.encode(), serial)
            kept[name].append(line)
            outbox.put(line) if name == "-" else outbox.put_in(shares[name], line)
    expected = sorted((line for lines in kept.values() for line in lines), key=lambda line: line[1:])
    drops = {name: share.dropped for name, share in shares.items()}
    sent = outbox.take(1 << 30)
    for name, dropped in drops.items():
        sent = sent.replace(b"<%d of %s>" % (dropped, name.encode()), b"", 1)
    assert sent == b"".join(expected)
