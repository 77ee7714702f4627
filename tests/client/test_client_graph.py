"""The client as a script uses it, on a real daemon."""

from __future__ import annotations

import os
import signal
from typing import Any

import pytest
from daemon_fixture import Runtime

from slidectl.client import Client
from slidectl.client.spawning import Spawn, SpawnPlan
from slidectl.errors import AmbiguousName, MessageRefused, Refused, TimedOut, UnknownName, Unused

BALL = """<sdf version="1.6"><model name="{}"><link name="body">
<collision name="c"><geometry><sphere><radius>0.1</radius></sphere></geometry></collision></link></model></sdf>"""


def test_a_call_gives_the_response(client: Client) -> None:
    before = client.call("/slidectl/status")["cycles"]
    assert client.call("/slidectl/step", {"cycles": 3})["cycles"] == before + 3


def test_a_call_that_fails_raises_with_the_daemons_words_and_exit_code(client: Client) -> None:
    with pytest.raises(Refused, match="/slidectl/statu") as failure:
        client.call("/slidectl/statu")
    assert failure.value.exit_code == 1
    with pytest.raises(Refused, match="cycels") as failure:
        client.call("/slidectl/step", {"cycels": 1})
    assert failure.value.exit_code == 2


def test_calls_can_be_on_their_way_together(client: Client) -> None:
    calls = [client.call_async("/rosapi/topic_type", {"topic": "/clock"}) for _ in range(50)]
    assert {client.answer(call)["type"] for call in reversed(calls)} == {"rosgraph_msgs/Clock"}


def test_what_is_published_arrives_in_order(daemon: Runtime, client: Client) -> None:
    with daemon.client() as writer, client.subscribe("/numbers", "std_msgs/Int32") as numbers:
        for number in range(100):
            writer.publish("/numbers", {"data": number})
        writer.flush()
        assert [next(numbers)["data"] for _ in range(100)] == list(range(100))
        assert numbers.dropped == 0


def test_a_new_topic_is_made_by_publishing_with_a_type(daemon: Runtime, client: Client) -> None:
    with daemon.client() as writer:
        writer.publish("/fresh", {"data": "x"}, type="std_msgs/String", latch=True)
        writer.flush()
        with client.subscribe("/fresh") as messages:
            assert messages.get()["data"] == "x"


def test_flush_raises_the_refusal_of_a_message(client: Client) -> None:
    with client.subscribe("/strict", "std_msgs/Int32"):
        client.publish("/strict", {"data": "seven"})
        with pytest.raises(MessageRefused, match="data") as failure:
            client.flush()
        assert failure.value.exit_code == 2
        client.flush()


def test_leaving_a_client_raises_what_was_refused(daemon: Runtime) -> None:
    with pytest.raises(MessageRefused, match="/nowhere"), daemon.client() as client:
        client.publish("/nowhere", {})


def test_subscribing_what_does_not_exist_says_what_does(client: Client) -> None:
    with pytest.raises(MessageRefused, match="/clock"):
        client.subscribe("/cloc")


def test_two_subscriptions_of_one_topic_both_get_every_message(client: Client) -> None:
    with client.subscribe("/both", "std_msgs/Int32") as one, client.subscribe("/both") as other:
        client.publish("/both", {"data": 5})
        client.flush()
        assert one.get() == other.get() == {"data": 5}
        one.close()
        client.publish("/both", {"data": 6})
        client.flush()
        assert (len(one), other.get()["data"]) == (0, 6)


def test_a_short_queue_keeps_the_newest_and_counts_the_rest(client: Client) -> None:
    with client.subscribe("/flood", "std_msgs/Int32", queue_length=3) as messages:
        for number in range(50):
            client.publish("/flood", {"data": number})
        client.flush()
        received = [messages.get()["data"] for _ in range(len(messages))]
        assert received == [47, 48, 49]
        assert messages.dropped == 47


def test_messages_that_came_before_closing_can_still_be_read(client: Client) -> None:
    messages = client.subscribe("/late", "std_msgs/Int32")
    client.publish("/late", {"data": 1})
    client.flush()
    messages.close()
    assert messages.get()["data"] == 1


def test_waiting_for_a_message_of_a_paused_world_says_that_it_is_paused(client: Client) -> None:
    with client.subscribe("/clock") as clock, pytest.raises(TimedOut, match="sim resume") as failure:
        clock.get(timeout=0.01)
    assert "/clock" in failure.value.message


def test_a_call_that_needs_time_says_that_the_world_is_paused(client: Client) -> None:
    with pytest.raises(TimedOut, match="paused"):
        client.call("/slidectl/sleep", {"duration": 1.0}, timeout=0.01)
    assert client.call("/slidectl/status")["paused"] is True


def test_an_earlier_refusal_is_no_reason_not_to_subscribe(client: Client) -> None:
    with client.subscribe("/strict", "std_msgs/Int32") as strict:
        client.publish("/strict", {"data": "seven"})
        with client.subscribe("/other", "std_msgs/Int32") as other:
            client.publish("/other", {"data": 7})
            with pytest.raises(MessageRefused, match="data"):
                client.flush()
            assert (len(strict), other.get()) == (0, {"data": 7})


def test_an_advertisement_that_was_refused_is_refused_again(client: Client) -> None:
    for _ in range(2):
        client.advertise("/odd", "no_such/Type")
        with pytest.raises(MessageRefused, match="no_such/Type"):
            client.flush()


def test_a_subscription_that_was_not_answered_is_taken_back(daemon: Runtime) -> None:
    with daemon.client(timeout=0.5) as client, daemon.client() as observer:
        os.kill(client.daemon_pid, signal.SIGSTOP)
        try:
            with pytest.raises(TimedOut):
                client.subscribe("/late", "std_msgs/Int32")
        finally:
            os.kill(client.daemon_pid, signal.SIGCONT)
        client.timeout = 10.0
        client.call("/rosapi/get_time")
        assert observer.call("/rosapi/subscribers", {"topic": "/late"})["subscribers"] == []


def test_services_are_found_by_their_end(client: Client) -> None:
    assert client.resolve("service", "set_speed")["name"] == "/slidectl/set_speed"


def test_events_are_what_is_on_the_wire(client: Client) -> None:
    with client.subscribe("/raw", "std_msgs/Int32"):
        client.publish("/raw", {"data": 1})
        assert next(client.events(timeout=10)) == {"op": "publish", "topic": "/raw", "msg": {"data": 1}}


def test_a_message_larger_than_any_buffer_goes_both_ways(client: Client) -> None:
    text = "x" * 3_000_000
    with client.subscribe("/large", "std_msgs/String") as messages:
        client.publish("/large", {"data": text})
        assert messages.get()["data"] == text


def test_refusals_that_nobody_reads_do_not_stop_the_sender(client: Client) -> None:
    for _ in range(20_000):
        client.publish("/nowhere", {"data": "this is refused, and the refusal is longer than the question"})
    with pytest.raises(MessageRefused, match="/nowhere"):
        client.flush()


def test_a_call_times_out_although_messages_keep_coming(client: Client, daemon: Runtime) -> None:
    with daemon.client() as driver, client.subscribe("/clock"):
        steps = driver.call_async("/slidectl/step", {"cycles": 10**9})
        driver.flush()
        with pytest.raises(TimedOut, match="did not answer"):
            client.call("/slidectl/sleep", {"duration": 1e6}, timeout=0.05)
        driver.call("/gazebo/pause_physics")  # gives the steps up
        assert driver.answer(steps)["success"] is False


def test_names_are_resolved_among_those_that_are_published_or_subscribed(daemon: Runtime, client: Client) -> None:
    with daemon.client() as other:
        other.advertise("/one/data", "std_msgs/Int32")
        other.advertise("/two/data", "std_msgs/Int32")
        with other.subscribe("/two/data"):
            assert client.resolve("topic", "data", role="subscribers")["name"] == "/two/data"
            assert client.resolve("topic", "data", role="publishers", namespace="/one")["name"] == "/one/data"
            assert client.resolve("topic", "/two/data")["name"] == "/two/data"
            with pytest.raises(AmbiguousName, match="/one/data, /two/data") as ambiguous:
                client.resolve("topic", "data", role="publishers")
            assert ambiguous.value.matches == ["/one/data", "/two/data"]
            with pytest.raises(UnknownName, match="two/data"):
                client.resolve("topic", "dat", role="subscribers")
            with pytest.raises(Unused, match=r"nobody subscribes to /one/data\. Did you mean '/two/data'"):
                client.resolve("topic", "/one/data", role="subscribers")


def test_names_of_every_kind_are_resolved_and_described_by_the_daemon(client: Client) -> None:
    found = client.resolve("service", "set_speed")
    assert (found["type"], found["nodes"]) == ("slidectl/SetSpeed", ["/slidectl"])
    assert [found[key][0]["fieldnames"] for key in ("typedefs", "response_typedefs")] == [
        ["speed"],
        ["success", "message"],
    ]
    clock = client.resolve("topic", "clock/clock/secs", with_field=True)
    assert (clock["name"], clock["field"], clock["type"]) == ("/clock", "clock/secs", "rosgraph_msgs/Clock")
    client.call("/rosapi/set_param", {"name": "/left/pid/p", "value": "1"})
    assert client.resolve("parameter", "pid")["name"] == "/left/pid"
    assert client.resolve("node", "slidectl")["name"] == "/slidectl"
    with pytest.raises(UnknownName, match="no robot 'slider'"):
        client.resolve("robot", "slider")
    with pytest.raises(Refused, match="kinds: topic, service, parameter, node, robot"):
        client.resolve("tpic", "clock")


def test_a_service_of_a_client_answers_its_callers_whatever_happens(daemon: Runtime, client: Client) -> None:
    with daemon.client() as provider:
        asked: list[Any] = []
        answers: list[Any] = [{"message": {1, 2}}, {"success": True, "message": "first"}]
        for name, answer in zip(("/mine/bad", "mine/ask"), answers, strict=True):
            provider.advertise_service(name, "std_srvs/Trigger", lambda _, answer=answer: asked.append(1) or answer)
        with pytest.raises(Refused, match="this client already provides /mine/ask"):
            provider.advertise_service("/mine/ask", "std_srvs/Trigger", lambda _: {})
        calls = [client.call_async(service) for service in ("/mine/bad", "/mine/ask")]
        client.flush()
        provider.wait_until(lambda: len(asked) == 2, 20.0, "nobody called")
        with pytest.raises(Refused, match="set is not JSON"):
            client.answer(calls[0])
        assert client.answer(calls[1])["message"] == "first"


def test_a_model_that_cannot_be_spawned_does_not_take_another_ones_with_it(
    daemon: Runtime, client: Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    pose = {"position": {"x": 0.0, "y": 0.0, "z": 2.0}}
    models = [{"model_name": name, "model_xml": BALL.format(name), "initial_pose": pose} for name in ("a", "theirs")]
    with daemon.client() as other:
        call = client.call

        def call_late(service: str, *given: Any, **options: Any) -> Any:
            if service == "/slidectl/status":  # after it has checked that the names are free
                Spawn(other, SpawnPlan(models[1:], is_scene=True)).apply()
            return call(service, *given, **options)

        monkeypatch.setattr(client, "call", call_late)
        with pytest.raises(Refused, match="theirs"):
            Spawn(client, SpawnPlan(models, is_scene=True)).apply()
        assert [robot["name"] for robot in other.robots()] == ["theirs"]
        other.delete("theirs")
