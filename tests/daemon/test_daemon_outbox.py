"""The outbox: order, bounds, and the honest count of what was given up."""

from __future__ import annotations

from collections import deque

import pytest
from hypothesis import given
from hypothesis import strategies as st

from slidectl.daemon.outbox import MOST_BYTES, MOST_BYTES_IN_ALL, Channel, Outbox, Publications, ReaderPosition


def report(topic: str, dropped: int) -> bytes:
    return b"<%d of %s>" % (dropped, topic.encode())


class Desk:
    """One client's outbox, and topics that it reads."""

    def __init__(self, publications: Publications | None = None) -> None:
        self.publications = publications or Publications()
        self.outbox = Outbox(report, self.publications)

    def send(self, line: bytes) -> None:
        self.outbox.add(line)

    def channel(self, topic: str, limit: int) -> Channel:
        """A topic with this client as its reader."""
        channel = Channel(topic, self.publications)
        self.read(channel, limit)
        return channel

    def read(self, channel: Channel, limit: int) -> ReaderPosition:
        share = channel.readers[self] = ReaderPosition(channel, limit)
        self.outbox.join(share)
        return share


@pytest.fixture
def desk() -> Desk:
    return Desk()


def test_a_reader_who_is_behind_gets_the_newest_and_one_report_where_the_gap_is(desk: Desk) -> None:
    channel = desk.channel("t", 2)
    desk.outbox.add(b"answer")
    for number in range(5):
        channel.add(b"%d" % number)
    desk.outbox.add(b"end")
    assert desk.outbox.next_piece(100) == b"answer<3 of t>34end"
    channel.add(b"5")
    assert desk.outbox.next_piece(100) == b"5"


def test_topics_do_not_take_room_from_each_other(desk: Desk) -> None:
    small, large = desk.channel("small", 1), desk.channel("large", 3)
    for number in range(3):
        small.add(b"s%d" % number)
        large.add(b"l%d" % number)
    assert desk.outbox.next_piece(100) == b"l0l1<2 of small>s2l2"


def test_large_messages_are_bounded_by_their_bytes_and_the_newest_is_kept(desk: Desk) -> None:
    channel = desk.channel("t", 1000)
    for _ in range(5):
        channel.add(b"x" * (MOST_BYTES // 2))
    channel.add(b"y" * (MOST_BYTES + 1))
    assert channel.size == desk.publications.kept == MOST_BYTES + 1
    assert desk.outbox.next_piece(1) == b"<5 of t>" + b"y" * (MOST_BYTES + 1)


def test_readers_who_stop_have_the_lines_of_a_topic_in_common(desk: Desk) -> None:
    channel = desk.channel("t", 100)
    others = [Desk(desk.publications) for _ in range(50)]
    for other in others:
        other.read(channel, 100)
    for number in range(100_000):
        channel.add(b"%06d" % number)
    assert desk.publications.kept == channel.size < 500 * 6
    expected = b"<99900 of t>" + b"".join(b"%06d" % number for number in range(99_900, 100_000))
    assert [each.outbox.next_piece(10_000) for each in (desk, *others)] == [expected] * 51


def test_a_reader_who_reads_loses_nothing_beside_one_who_does_not(desk: Desk) -> None:
    channel = desk.channel("t", 10)
    Desk(desk.publications).read(channel, 10)
    received = []
    for number in range(5000):
        channel.add(b"%05d" % number)
        received.append(desk.outbox.next_piece(100))
    assert received == [b"%05d" % number for number in range(5000)]


def test_what_all_have_read_is_given_up(desk: Desk) -> None:
    channel = desk.channel("t", 1000)
    for _ in range(10):
        channel.add(b"x" * 100)
    desk.outbox.next_piece(10_000)
    channel.tidy()
    assert channel.size == 0


def test_topics_of_large_messages_are_bounded_together() -> None:
    publications = Publications()
    reader = Desk(publications)
    for number in range(100):
        channel = publications.channel(f"/t{number}")
        reader.read(channel, 10)
        channel.publish({"data": "x" * 1_000_000})
    assert publications.kept <= MOST_BYTES_IN_ALL
    sent = b"".join(iter(lambda: reader.outbox.next_piece(1_000_000), b""))
    told = sent.count(b"<1 of /t")
    assert told > 0
    assert told + sent.count(b"\n") == 100


def test_a_share_that_ends_sends_nothing_more(desk: Desk) -> None:
    channel = desk.channel("t", 2)
    for number in range(5):
        channel.add(b"%d" % number)
    desk.outbox.add(b"answer")
    desk.outbox.leave(channel.readers[desk])
    assert desk.outbox.next_piece(100) == b"answer"


def test_a_share_that_is_replaced_sends_what_it_has_waiting(desk: Desk) -> None:
    channel = desk.channel("t", 2)
    for number in range(3):
        channel.add(b"%d" % number)
    desk.outbox.add(b"answer")
    desk.outbox.retire(channel.readers[desk])
    channel.add(b"3")
    assert desk.outbox.next_piece(100) == b"answer<1 of t>12"
    assert desk.outbox.unbounded == 0


@given(st.lists(st.tuples(st.sampled_from("abc-"), st.integers(1, 600)), max_size=10), st.integers(1, 5000))
def test_any_history_gives_what_a_plain_queue_per_share_would_keep(history: list[tuple[str, int]], most: int) -> None:
    desk = Desk()
    limits = {"a": 1, "b": 7, "c": 300}
    channels = {name: desk.channel(name, limit) for name, limit in limits.items()}
    kept: dict[str, deque[bytes]] = {name: deque(maxlen=limit) for name, limit in limits.items()}
    kept["-"] = deque()
    drops = dict.fromkeys(limits, 0)
    serial = 0
    for name, count in history:
        for _ in range(count):
            serial += 1
            line = b"%s%05d" % (name.encode(), serial)
            if name == "-":
                desk.outbox.add(line)
            else:
                drops[name] += len(kept[name]) == limits[name]
                channels[name].add(line)
            kept[name].append(line)
    expected = sorted((line for lines in kept.values() for line in lines), key=lambda line: line[1:])
    sent = b"".join(iter(lambda: desk.outbox.next_piece(most), b""))
    for name, dropped in drops.items():
        assert (report(name, dropped) in sent) == bool(dropped)
        sent = sent.replace(report(name, dropped), b"", 1)
    assert sent == b"".join(expected)
