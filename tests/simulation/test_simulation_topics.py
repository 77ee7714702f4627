"""The topic bus: delivery, types, latching, `wanted`, and what a refusal reaches."""

from __future__ import annotations

from typing import Any

import pytest

from slidectl import msgs
from slidectl.errors import BadMessage, BadName, MessageRefused, UnknownName
from slidectl.simulation.graph import Graph
from slidectl.simulation.topics import NodePublisher, Topics, TypeConflict

FLOAT = "std_msgs/Float64"


@pytest.fixture
def topics() -> Topics:
    return Topics()


def test_a_message_reaches_all_subscribers_in_the_order_of_their_coming(topics: Topics) -> None:
    heard: list[tuple[str, Any]] = []
    topics.subscribe("/level", FLOAT, "/b", lambda message: heard.append(("b", message)))
    topics.subscribe("/level", FLOAT, "/a", lambda message: heard.append(("a", message)))
    topics.advertise("/level", FLOAT, "/sim").publish({"data": 1.5})
    assert heard == [("b", {"data": 1.5}), ("a", {"data": 1.5})]


def test_a_publisher_is_wanted_only_while_somebody_subscribes(topics: Topics) -> None:
    publisher = topics.advertise("/level", FLOAT, "/sim")
    assert not publisher.wanted
    subscription = topics.subscribe("/level", None, "/me", lambda _: None)
    assert publisher.wanted
    subscription.close()
    assert not publisher.wanted


def test_a_latched_publisher_is_always_wanted_and_tells_late_comers_its_last_message(topics: Topics) -> None:
    publisher = topics.advertise("/map", FLOAT, "/sim", latch=True)
    assert publisher.wanted
    publisher.publish({"data": 1.0})
    publisher.publish({"data": 2.0})
    heard: list[Any] = []
    topics.subscribe("/map", FLOAT, "/late", heard.append)
    assert heard == [{"data": 2.0}]


def test_a_latched_message_goes_with_its_publisher(topics: Topics) -> None:
    publisher = topics.advertise("/map", FLOAT, "/sim", latch=True)
    publisher.publish({"data": 1.0})
    topics.subscribe("/map", FLOAT, "/early", lambda _: None)
    publisher.close()
    heard: list[Any] = []
    topics.subscribe("/map", FLOAT, "/late", heard.append)
    assert heard == []


def test_each_publisher_numbers_its_headers_from_1(topics: Topics) -> None:
    heard: list[int] = []
    topics.subscribe("/joints", "sensor_msgs/JointState", "/me", lambda message: heard.append(message["header"]["seq"]))
    for node in ("/one", "/two"):
        topics.publish("/joints", None, {}, node)
        topics.publish("/joints", None, {"header": {"seq": 99}}, node)
    assert heard == [1, 2, 1, 2]


def test_publishers_inside_count_from_0_and_count_what_nobody_wanted(topics: Topics) -> None:
    heard: list[int] = []
    publisher = topics.advertise("/joints", "sensor_msgs/JointState", "/gazebo", kind=NodePublisher)
    publisher.publish(msgs.default("sensor_msgs/JointState"))
    publisher.sequence += 1
    topics.subscribe("/joints", None, "/me", lambda message: heard.append(message["header"]["seq"]))
    publisher.publish(msgs.default("sensor_msgs/JointState"))
    assert heard == [2]


def test_another_type_for_a_topic_is_refused_and_says_who_uses_it(topics: Topics) -> None:
    topics.advertise("/level", FLOAT, "/sim")
    for attempt in (
        lambda: topics.advertise("/level", "std_msgs/Bool", "/me"),
        lambda: topics.subscribe("/level", "std_msgs/Bool", "/me", lambda _: None),
        lambda: topics.publish("/level", "std_msgs/Bool", {"data": True}, "/me"),
    ):
        with pytest.raises(TypeConflict, match="has the type std_msgs/Float64, not std_msgs/Bool") as caught:
            attempt()
        assert "/sim" in str(caught.value)


def test_an_unknown_type_is_named_whether_the_topic_exists_or_not(topics: Topics) -> None:
    topics.advertise("/level", FLOAT, "/sim")
    for topic in ("/level", "/other"):
        with pytest.raises(UnknownName, match="std_msgs/Flaot64"):
            topics.advertise(topic, "std_msgs/Flaot64", "/me")
    assert topics.names() == ["/level"]


def test_a_topic_without_a_type_must_exist(topics: Topics) -> None:
    topics.advertise("/level", FLOAT, "/sim")
    with pytest.raises(UnknownName, match="Did you mean '/level'"):
        topics.subscribe("/levle", None, "/me", lambda _: None)
    with pytest.raises(UnknownName):
        topics.publish("/levle", None, {"data": 1.0}, "/me")


def test_a_topic_lives_as_long_as_somebody_uses_it(topics: Topics) -> None:
    publisher = topics.advertise("/level", FLOAT, "/sim")
    subscription = topics.subscribe("/level", None, "/me", lambda _: None)
    publisher.close()
    assert topics.types() == {"/level": FLOAT}
    subscription.close()
    subscription.close()
    assert topics.names() == []


def test_a_message_from_outside_is_completed_and_checked(topics: Topics) -> None:
    heard: list[Any] = []
    topics.subscribe("/point", "geometry_msgs/Point", "/me", heard.append)
    topics.publish("/point", None, {"x": 1}, "/client")
    assert heard == [{"x": 1.0, "y": 0.0, "z": 0.0}]
    with pytest.raises(BadMessage, match="geometry_msgs/Point"):
        topics.publish("/point", None, {"q": 1}, "/other")
    assert topics.publishers("/point") == ["/client"], "a message that was refused makes nobody a publisher"


def test_a_client_that_advertised_latched_stays_latched_when_it_publishes(topics: Topics) -> None:
    topics.advertise("/level", FLOAT, "/client", latch=True)
    topics.publish("/level", None, {"data": 3}, "/client")
    heard: list[Any] = []
    topics.subscribe("/level", None, "/late", heard.append)
    assert heard == [{"data": 3.0}]
    assert topics.publishers("/level") == ["/client"]


def refuse(_message: Any) -> None:
    raise MessageRefused("not a number")


def test_a_refusal_comes_back_to_the_client_after_all_have_heard_the_message(topics: Topics) -> None:
    heard: list[Any] = []
    topics.subscribe("/level", FLOAT, "/picky", refuse)
    topics.subscribe("/level", FLOAT, "/me", heard.append)
    with pytest.raises(MessageRefused, match="not a number"):
        topics.publish("/level", None, {"data": 1.0}, "/client")
    assert heard == [{"data": 1.0}]


def test_a_publisher_inside_does_not_hear_refusals(topics: Topics) -> None:
    topics.subscribe("/level", FLOAT, "/picky", refuse)
    topics.advertise("/level", FLOAT, "/sim", kind=NodePublisher).publish({"data": 1.0})


def test_a_latched_message_that_is_refused_does_not_keep_a_subscriber_out(topics: Topics) -> None:
    publisher = topics.advertise("/level", FLOAT, "/client", latch=True)
    publisher.publish({"data": 1.0})
    topics.subscribe("/level", FLOAT, "/picky", refuse)
    assert topics.subscribers("/level") == ["/picky"]


def test_a_subscriber_may_leave_while_a_message_is_delivered(topics: Topics) -> None:
    heard: list[str] = []
    first = topics.subscribe("/level", FLOAT, "/first", lambda _: (heard.append("first"), first.close()))
    topics.subscribe("/level", FLOAT, "/second", lambda _: heard.append("second"))
    publisher = topics.advertise("/level", FLOAT, "/sim")
    publisher.publish({"data": 1.0})
    publisher.publish({"data": 2.0})
    assert heard == ["first", "second", "second"]


@pytest.mark.parametrize("name", ["/bad name", "/a//b", "/a/", ""])
def test_illegal_names_are_refused(topics: Topics, name: str) -> None:
    with pytest.raises(BadName):
        topics.advertise(name, FLOAT, "/me")


@pytest.mark.parametrize(("name", "hint"), [("level", "write /level"), ("/", "the root of all names")])
def test_a_name_that_is_relative_or_only_the_root_is_refused(topics: Topics, name: str, hint: str) -> None:
    with pytest.raises(BadName, match=hint):
        topics.advertise(name, FLOAT, "/me")


def test_when_a_node_goes_all_that_it_had_goes(graph: Graph) -> None:
    graph.topics.advertise("/out", FLOAT, "/client")
    graph.topics.subscribe("/in", FLOAT, "/client", lambda _: None)
    graph.services.advertise("/ask", "std_srvs/Empty", "/client", lambda _: {})
    assert "/client" in graph.nodes()
    graph.close_node("/client")
    assert "/client" not in graph.nodes()
    assert not {"/out", "/in"} & set(graph.topics.names())
    assert not graph.services.exists("/ask")


def test_names_of_publishers_and_subscribers_are_listed_once(topics: Topics) -> None:
    for _ in range(2):
        topics.advertise("/level", FLOAT, "/sim")
        topics.subscribe("/level", FLOAT, "/me", lambda _: None)
    assert topics.publishers("/level") == ["/sim"]
    assert topics.subscribers("/level") == ["/me"]
    assert topics.publishers("/nope") == topics.subscribers("/nope") == []
