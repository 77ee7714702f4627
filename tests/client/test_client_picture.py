"""What a connection remembers about the graph: as good as what it would be told now."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from daemon_fixture import Runtime

from slidectl.client import Client
from slidectl.client.picture import Picture
from slidectl.errors import MessageRefused, UsageError


class Names:
    """Asks for the services, topics and parameters, and counts how often."""

    def __init__(self, client: Client) -> None:
        self.picture = Picture(client)
        self.asked = 0
        self._client = client

    def __call__(self) -> dict[str, list[str]]:
        self.picture.refresh()
        return self.picture.recall("names", self._ask)

    def _ask(self) -> dict[str, list[str]]:
        self.asked += 1
        ask = self._client.call
        return {
            "topics": [
                f"{name} {ask('/rosapi/subscribers', {'topic': name})}" for name in ask("/rosapi/topics")["topics"]
            ],
            "services": ask("/rosapi/services")["services"],
            "parameters": ask("/rosapi/get_param_names")["names"],
        }


def test_what_was_found_is_remembered_while_nothing_changes(client: Client) -> None:
    names = Names(client)
    first = names()
    client.call("/rosapi/set_param", {"name": "/picture/known", "value": "1"})
    second = names()
    client.call("/rosapi/set_param", {"name": "/picture/known", "value": "2"})
    client.call("/slidectl/step", {"cycles": 10})
    assert names() is second
    assert "/picture/known" in second["parameters"]
    assert "/picture/known" not in first["parameters"]
    assert names.asked == 2


CHANGES: dict[str, Callable[[Client], object]] = {
    "a publisher comes": lambda other: other.advertise("/picture/new", "std_msgs/Int32"),
    "a subscriber comes": lambda other: other.subscribe("/picture/new", "std_msgs/Int32"),
    "a service comes": lambda other: other._send(
        op="advertise_service", service="/picture/service", type="std_srvs/Empty"
    ),
    "a parameter comes": lambda other: other.call("/rosapi/set_param", {"name": "/picture/other", "value": "1"}),
    "a parameter goes": lambda other: other.call("/rosapi/delete_param", {"name": "/picture/other"}),
    "a parameter becomes a namespace": lambda other: other.call(
        "/rosapi/set_param", {"name": "/picture/known", "value": '{"below": 1}'}
    ),
    "a namespace becomes a parameter": lambda other: other.call(
        "/rosapi/set_param", {"name": "/picture/known", "value": "1"}
    ),
}


@pytest.mark.parametrize("change", CHANGES.values(), ids=CHANGES)
def test_what_another_client_changes_is_seen_at_once(
    daemon: Runtime, client: Client, change: Callable[[Client], object]
) -> None:
    names = Names(client)
    with daemon.client() as other:
        other.call("/rosapi/set_param", {"name": "/picture/known", "value": "1"})
        if change is CHANGES["a parameter goes"]:
            other.call("/rosapi/set_param", {"name": "/picture/other", "value": "1"})
        if change is CHANGES["a namespace becomes a parameter"]:
            other.call("/rosapi/set_param", {"name": "/picture/known", "value": '{"below": 1}'})
        before = names()
        change(other)
        other.flush()
        during = names()
        assert during != before
    client.call("/rosapi/delete_param", {"name": "/picture"})


def test_a_client_that_leaves_is_seen(daemon: Runtime, client: Client) -> None:
    names = Names(client)
    with daemon.client() as other:
        other.advertise("/picture/passing", "std_msgs/Int32")
        other.flush()
        assert any("/picture/passing" in topic for topic in names()["topics"])
    client.flush()
    assert not any("/picture/passing" in topic for topic in names()["topics"])


def test_the_news_of_a_change_comes_before_the_answer_to_the_call_that_made_it(client: Client) -> None:
    notice = client.call_async("/slidectl/next_change")
    client.call("/slidectl/step", {"cycles": 1})
    assert not client.is_answered(notice)
    change = client.call_async("/rosapi/set_param", {"name": "/picture/first", "value": "1"})
    answers = [event["id"] for event, _ in zip(client.events(10), range(2), strict=False)]
    assert answers == [notice, change]


def test_what_changes_while_it_is_looked_up_is_not_remembered(daemon: Runtime, client: Client) -> None:
    picture = Picture(client)
    with daemon.client() as other:

        def find() -> list[str]:
            found: list[str] = client.call("/rosapi/topics")["topics"]
            other.advertise("/picture/meanwhile", "std_msgs/Int32")
            other.flush()
            client.flush()
            return found

        assert "/picture/meanwhile" not in picture.recall("topics", find)
        assert "/picture/meanwhile" in picture.recall("topics", lambda: client.call("/rosapi/topics")["topics"])


def test_a_failed_look_up_is_not_remembered(client: Client) -> None:
    picture = Picture(client)
    with pytest.raises(ZeroDivisionError):
        picture.recall("x", lambda: 1 / 0)
    assert picture.recall("x", lambda: 2.0) == 2.0


def test_a_message_is_delivered_or_refused_in_one_go(daemon: Runtime, client: Client) -> None:
    with daemon.client() as reader, reader.subscribe("/picture/numbers", "std_msgs/Int32") as numbers:
        client.deliver("/picture/numbers", {"data": 1})
        client.deliver("/picture/numbers", {"data": 2}, type="std_msgs/Int32", latch=True)
        with pytest.raises(MessageRefused, match="data"):
            client.deliver("/picture/numbers", {"data": "three"})
        client.deliver("/picture/numbers", {"data": 4})
        reader.flush()
        assert [numbers.get()["data"] for _ in range(len(numbers))] == [1, 2, 4]


def test_what_fits_no_line_is_refused_before_it_leaves(client: Client) -> None:
    with pytest.raises(UsageError, match="more than the 16777216 that fit a line"):
        client.call("/rosapi/set_param", {"name": "/long", "value": "x" * 2**24})
    assert client.call("/rosapi/has_param", {"name": "/long"}) == {"exists": False}
