"""What gateways ask of the daemon: the whole graph at once, its changes, and nodes that go by names of their own."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

Connect = Callable[[], Any]


def graph(wire: Any) -> dict[str, Any]:
    values: dict[str, Any] = wire.call("/slidectl/graph")["values"]
    return values


def test_a_connection_that_names_its_node_is_listed_by_that_name(connect: Connect) -> None:
    talker, other = connect(), connect()
    talker.send(op="set_node", node="/talker")
    talker.send(op="advertise", topic="/chatter", type="std_msgs/String")
    talker.send(op="advertise_service", service="/say", type="std_srvs/Empty")
    talker.send(op="subscribe", topic="/heard", type="std_msgs/String")
    talker.call("/rosapi/get_time")
    state = graph(other)
    topics = {one["name"]: one for one in state["topics"]}
    assert topics["/chatter"] == {
        "name": "/chatter", "type": "std_msgs/String", "publishers": ["/talker"], "subscribers": []
    }  # fmt: skip
    assert topics["/heard"]["subscribers"] == ["/talker"]
    say = {"name": "/say", "type": "std_srvs/Empty", "node": "/talker", "effects": ["writes"]}
    assert say in state["services"]


def test_a_name_of_a_node_is_taken_once_and_free_when_its_connection_has_ended(connect: Connect) -> None:
    first, second, watcher = connect(), connect(), connect()
    first.send(op="set_node", node="/talker")
    first.call("/rosapi/get_time")
    second.send(op="set_node", id="twice", node="/talker")
    refused = second.receive()
    assert (refused["level"], refused["id"]) == ("error", "twice")
    assert "there is a node /talker already" in refused["msg"]
    second.send(op="set_node", node="/gazebo")
    assert "there is a node /gazebo already" in second.receive()["msg"]
    second.send(op="set_node", node="/slidectl_1_1")
    assert "reserved for clients without a name" in second.receive()["msg"]
    second.send(op="set_node", node="no name")
    assert second.receive()["level"] == "error"
    watcher.send(op="advertise", topic="/mine", type="std_msgs/String")
    watcher.send(op="set_node", node="/late")
    assert "set_node is its first op" in watcher.receive()["msg"]
    first.close()
    while True:
        second.send(op="set_node", id="again", node="/talker")
        second.send(op="call_service", id="taken", service="/rosapi/get_time")
        if second.receive().get("id") == "taken":
            break
        second.receive()
    second.send(op="advertise", topic="/chatter", type="std_msgs/String")
    assert watcher.call("/rosapi/publishers", topic="/chatter")["values"]["publishers"] == ["/talker"]


def test_changes_of_the_graph_and_of_parameters_are_published(connect: Connect) -> None:
    watcher, other = connect(), connect()
    watcher.send(op="subscribe", topic="/slidectl/graph_changes", type="std_msgs/Empty")
    watcher.call("/rosapi/get_time")

    def changes(topic: str) -> list[Any]:
        """All that has come of a topic."""
        watcher.send(op="call_service", id="end", service="/rosapi/get_time")
        found = []
        while (message := watcher.receive()).get("id") != "end":
            if message["op"] == "publish" and message["topic"] == topic:
                found.append(message["msg"])
        return found

    changes("/slidectl/graph_changes")
    for sent in (
        {"op": "advertise", "topic": "/chatter", "type": "std_msgs/String"},
        {"op": "subscribe", "topic": "/chatter"},
        {"op": "unadvertise", "topic": "/chatter"},
        {"op": "unsubscribe", "topic": "/chatter"},
        {"op": "advertise_service", "service": "/say", "type": "std_srvs/Empty"},
        {"op": "unadvertise_service", "service": "/say"},
    ):
        other.send(**sent)
        other.call("/rosapi/get_time")
        assert changes("/slidectl/graph_changes") == [{}], sent
    watcher.send(op="subscribe", topic="/slidectl/parameter_changes", type="slidectl/ParameterChanges")
    watcher.call("/rosapi/get_time")
    other.call("/rosapi/set_param", name="/a/b", value="[1, 2]")
    assert changes("/slidectl/parameter_changes") == [{"names": ["/a/b"]}]
    other.call("/rosapi/delete_param", name="/a")
    assert changes("/slidectl/parameter_changes") == [{"names": ["/a"]}]
