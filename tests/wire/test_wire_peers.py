"""Requests and answers without a connection: what one end writes, the other reads."""

from __future__ import annotations

from typing import Any

import pytest

from slidectl.errors import (
    AmbiguousName,
    MessageRefused,
    Reason,
    Refused,
    SlidectlError,
    UnknownName,
    Unused,
    UsageError,
)
from slidectl.wire import messages
from slidectl.wire.json_lines import LONGEST_LINE, BadLine, decode, encode
from slidectl.wire.peers import ClientPeer, Inbox


def refused(peer: ClientPeer, error: SlidectlError, reasons: list[Reason]) -> dict[str, Any]:
    """The answer to a call that is refused with the error, as the client has received it."""
    call_id, line = peer.call("/any", {"x": 1})
    message, wrong = messages.read_operation(line)
    assert wrong is None
    answer = messages.refused_call(error, message, messages.with_levels(reasons))
    assert peer.receive(decode(encode(answer))) == call_id
    return peer.answer(call_id)


@pytest.mark.parametrize("error", [Refused("no", "try again"), UsageError("wrong"), BadLine("too long")])
def test_a_refusal_arrives_with_its_text_and_exit_code(error: SlidectlError) -> None:
    with pytest.raises(Refused) as caught:
        messages.values_of(refused(ClientPeer(), error, []))
    assert str(caught.value) == str(error)
    assert caught.value.exit_code == error.exit_code


@pytest.mark.parametrize(
    "error",
    [
        UnknownName("topic", "clok", ["/clock"]),
        AmbiguousName("topic", "command", ["/a/command", "/b/command"]),
        Unused("subscribers", "/clock", []),
    ],
)
def test_an_error_about_a_name_arrives_as_what_it_was(error: SlidectlError) -> None:
    with pytest.raises(type(error)) as caught:
        messages.resolved(refused(ClientPeer(), error, []))
    assert str(caught.value) == str(error)
    assert getattr(caught.value, "matches", None) == getattr(error, "matches", None)


def test_the_reasons_of_an_answer_are_warnings_and_errors() -> None:
    answer = refused(ClientPeer(), Refused("no"), [Reason("a", "warn"), Reason("b", "error")])
    assert messages.reasons_of(answer) == (["a", "b"], ["a"], ["b"])
    assert messages.reasons_of({"reasons": ["of an older daemon"]}) == (
        ["of an older daemon"],
        [],
        ["of an older daemon"],
    )
    assert messages.reasons_of({}) == ([], [], [])


def test_only_the_first_call_has_the_version_and_only_awaited_answers_are_kept() -> None:
    peer, told = ClientPeer(), []
    peer.on_other_version = told.append
    (first, line), (second, other) = peer.call("/a", None), peer.call("/b", None)
    assert "version" in decode(line)
    assert "version" not in decode(other)
    peer.forget(second)
    for call_id in (first, second, "call:99"):
        peer.receive({"op": "service_response", "id": call_id, "values": {}, "result": True, "version": "0"})
    assert told == ["0"]
    assert list(peer.answers) == [first]


def test_refusals_are_raised_by_who_asks_and_the_first_of_the_others_by_all() -> None:
    peer = ClientPeer()
    ids = [peer.publish("/t", {"data": number})[0] for number in range(3)]
    for publish_id in ids:
        peer.receive(messages.error_status(UsageError(publish_id), {"id": publish_id}, {}))
    with pytest.raises(MessageRefused, match=ids[1]):
        peer.check_refused(ids[1])
    peer.check_refused(ids[1])
    with pytest.raises(MessageRefused, match=ids[0]):
        peer.check_all_refused()
    peer.check_all_refused()


def test_a_topic_is_heard_when_one_of_its_messages_is() -> None:
    peer = ClientPeer()
    for topic in ("/half", "/half", "/none"):
        publish_id, line = peer.publish(topic, {}, unheard=True)
    operation = decode(line)
    peer.receive(messages.unheard_status(operation, "/half"))
    peer.check_heard()
    peer.receive(messages.unheard_status(operation, "/none"))
    with pytest.raises(MessageRefused, match="nobody subscribes to /none: 1 published"):
        peer.check_heard()
    assert publish_id == operation["id"]


def test_an_inbox_keeps_the_newest_and_counts_the_rest() -> None:
    peer = ClientPeer()
    inbox = Inbox("/t", peer.next_id("subscribe"), 2, None)
    assert decode(peer.subscribe(inbox, 0, 2, None, is_stamped=False))["id"] == inbox.id
    for number in range(3):
        peer.receive({"op": "publish", "topic": "/t", "msg": {"data": number}})
    peer.receive(messages.dropped_status("/t", 4))
    assert ([message["data"] for message in inbox.queue], inbox.dropped) == ([1, 2], 5)
    assert decode(peer.unsubscribe(inbox))["op"] == "unsubscribe"
    assert peer.unsubscribe(inbox) == b""
    peer.receive({"op": "publish", "topic": "/t", "msg": {"data": 9}})
    assert len(inbox) == 2


def test_a_client_is_a_publisher_once_until_it_was_refused() -> None:
    peer = ClientPeer()
    line = peer.advertise("/t", "std_msgs/Int32", False)
    assert peer.advertise("/t", "std_msgs/Int32", False) == b""
    peer.receive(messages.error_status(Refused("no"), decode(line), {}))
    assert peer.advertise("/t", "std_msgs/Int32", False)
    peer.unadvertise("/t")
    assert peer.advertise("/t", "std_msgs/Int32", False)


def test_what_is_too_long_for_a_line_is_not_sent_and_not_awaited() -> None:
    peer = ClientPeer()
    for make in (lambda text: peer.call("/a", {"x": text}), lambda text: peer.publish("/t", {"x": text}, unheard=True)):
        with pytest.raises(BadLine, match="fit a line"):
            make("x" * LONGEST_LINE)
    assert not peer.awaited
    peer.check_heard()


@pytest.mark.parametrize(
    ("line", "known", "text"),
    [
        (b"[1]", {}, "not a JSON object but list"),
        (b'{"op": "jump", "id": "a"}', {"op": "jump", "id": "a"}, "unknown op 'jump'"),
        (b'{"id": "a"}', {"id": "a"}, "a message without an op"),
        (b'{"op": "publish", "id": "' + b"i" * 1001 + b'"}', {"op": "publish"}, "an id of more than 1000"),
        (
            b'{"op": "call_service", "id": 7, "service": "/s", "args": [' + b"1," * 100_000 + b"1]}",
            {"op": "call_service", "id": 7, "service": "/s"},
            "a line with 100005 values",
        ),
    ],
)
def test_a_line_that_is_no_operation_says_why_and_whose_it_is(line: bytes, known: dict[str, Any], text: str) -> None:
    message, error = messages.read_operation(line)
    assert message == known
    assert text in str(error)
