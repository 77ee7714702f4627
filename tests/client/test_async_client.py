"""The client on asyncio as a program uses it, on a real daemon."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from typing import Any

import pytest
from daemon_fixture import Runtime

from slidectl import AsyncClient
from slidectl.client import Client
from slidectl.errors import (
    AmbiguousName,
    MessageRefused,
    NoDaemon,
    Refused,
    SlidectlError,
    TimedOut,
    UnknownName,
    UsageError,
)
from slidectl.wire.peers import MessagesDropped


def run(daemon: Runtime, action: Callable[[AsyncClient], Awaitable[Any]], timeout: float = 10.0) -> Any:
    """What `action` returns for a connected client."""

    async def main() -> Any:
        async with AsyncClient(socket=daemon.paths.socket_text, timeout=timeout) as client:
            return await action(client)

    return asyncio.run(main())


def test_tasks_call_at_the_same_time_and_each_gets_its_own_answer(daemon: Runtime) -> None:
    async def main(client: AsyncClient) -> None:
        topics = ["/clock", "/rosout"] * 20
        answers = await asyncio.gather(*(client.call("/rosapi/topic_type", {"topic": topic}) for topic in topics))
        assert [answer["type"] for answer in answers] == ["rosgraph_msgs/Clock", "rosgraph_msgs/Log"] * 20

    run(daemon, main)


@pytest.mark.parametrize(
    ("service", "request_"),
    [
        ("/slidectl/statu", {}),
        ("/slidectl/step", {"cycels": 1}),
        ("/slidectl/load", {"name": "none"}),
        ("no_such", {}),
        ("controller_manager/load_controller", {}),
    ],
)
def test_a_refusal_is_that_of_the_blocking_client(
    daemon: Runtime, client: Client, service: str, request_: dict[str, Any]
) -> None:
    with pytest.raises(SlidectlError) as blocking:
        client.call(service, request_)

    async def main(other: AsyncClient) -> None:
        with pytest.raises(SlidectlError) as refused:
            await other.call(service, request_)
        assert type(refused.value) is type(blocking.value)
        assert str(refused.value) == str(blocking.value)
        assert refused.value.exit_code == blocking.value.exit_code
        assert (other.reasons, other.warnings, other.errors) == (client.reasons, client.warnings, client.errors)

    run(daemon, main)


def test_names_are_resolved_as_by_the_blocking_client(daemon: Runtime) -> None:
    async def main(client: AsyncClient) -> None:
        assert (await client.call("get_world_properties"))["success"]
        assert (await client.resolve("topic", "clock"))["name"] == "/clock"
        with pytest.raises(UnknownName):
            await client.resolve("topic", "clok")
        with pytest.raises(AmbiguousName):
            await client.call("get_loggers")

    with daemon.client() as one, daemon.client() as two:
        for name, provider in (("/one", one), ("/two", two)):
            provider.advertise_service(f"{name}/get_loggers", "roscpp/GetLoggers", lambda _: {"loggers": []})
        run(daemon, main)


def test_messages_arrive_in_order_and_wait_for_their_reader(daemon: Runtime) -> None:
    async def main(client: AsyncClient) -> None:
        async with await client.subscribe("/async/numbers", "std_msgs/Int32") as numbers:
            for number in range(100):
                client.publish("/async/numbers", {"data": number})
            assert [(await numbers.get())["data"] for _ in range(100)] == list(range(100))
            await client.deliver("/async/numbers", {"data": 100})
            async for message in numbers:
                assert message == {"data": 100}
                break
            with pytest.raises(TimedOut, match=r"no message on /async/numbers within 0.01 s"):
                await numbers.get(timeout=0.01)

    run(daemon, main)


def test_a_reader_that_is_too_slow_is_warned(daemon: Runtime) -> None:
    async def main(client: AsyncClient) -> None:
        numbers = await client.subscribe("/async/many", "std_msgs/Int32")
        for number in range(1500):
            client.publish("/async/many", {"data": number})
        await client.flush()
        assert (numbers.dropped, len(numbers)) == (500, 1000)
        with pytest.warns(MessagesDropped, match="500 messages of /async/many"):
            numbers.close()

    run(daemon, main)


def test_publishing_raises_what_was_refused_or_reached_nobody(daemon: Runtime) -> None:
    async def refused(client: AsyncClient) -> None:
        await client.subscribe("/async/strict", "std_msgs/Int32")
        client.publish("/async/strict", {"data": "seven"})
        with pytest.raises(MessageRefused, match="data") as failure:
            await client.flush()
        assert failure.value.exit_code == 2
        with pytest.raises(MessageRefused, match="data"):
            await client.deliver("/async/strict", {"data": "seven"})
        with pytest.raises(UsageError, match="fit a line"):
            client.publish("/async/strict", {"data": "x" * 17_000_000})

    async def unheard(client: AsyncClient) -> None:
        client.publish("/async/nobody", {"data": 1}, type="std_msgs/Int32")

    run(daemon, refused)
    with pytest.raises(MessageRefused, match="nobody subscribes to /async/nobody: 1 published"):
        run(daemon, unheard)


def test_a_subscription_that_is_refused_leaves_nothing(daemon: Runtime) -> None:
    async def main(client: AsyncClient) -> None:
        with pytest.raises(Refused, match="std_msgs/Int32"):
            await client.subscribe("/clock", "std_msgs/Int32")
        taken: list[Any] = []
        await client.subscribe("/async/twice", "std_msgs/Int32", take=taken.append)
        await client.subscribe("/async/twice", take=taken.append)
        await client.deliver("/async/twice", {"data": 1})
        assert [published["msg"] for published in taken] == [{"data": 1}] * 2
        client.unsubscribe("/async/twice")
        await client.deliver("/async/twice", {"data": 2})
        assert len(taken) == 2

    run(daemon, main)


def test_services_are_provided_by_tasks(daemon: Runtime, client: Client) -> None:
    async def main(provider: AsyncClient) -> None:
        async def slow(request: dict[str, Any]) -> dict[str, Any]:
            if not request["name"]:
                raise ValueError("no name")
            await asyncio.sleep(0)
            return {"exists": request["name"] == "mine"}

        await provider.advertise_service("/async/is_mine", "rosapi/HasParam", slow)
        with pytest.raises(Refused, match="/async/is_mine"):
            await provider.advertise_service("/async/is_mine", "rosapi/HasParam", slow)
        await provider.advertise_service("/async/again", "rosapi/HasParam", slow)
        calls = [client.call_async("/async/again", {"name": name}) for name in ("mine", "his")]
        failing = client.call_async("/async/again", {"name": ""})
        answers = [await asyncio.to_thread(client.answer, call) for call in calls]
        assert [answer["exists"] for answer in answers] == [True, False]
        with pytest.raises(Refused, match="no name"):
            await asyncio.to_thread(client.answer, failing)
        provider.unadvertise_service("/async/again")
        await provider.flush()
        with pytest.raises(Refused, match="/async/again"):
            await asyncio.to_thread(client.call, "/async/again", {"name": "x"})

    run(daemon, main)


def test_a_call_that_is_not_answered_times_out_or_is_cancelled(daemon: Runtime) -> None:
    async def main(caller: AsyncClient) -> None:
        with pytest.raises(TimedOut, match=r"/slidectl/sleep did not answer within 0.05 s"):
            await caller.call("/slidectl/sleep", {"duration": 1.0}, timeout=0.05)
        task = asyncio.create_task(caller.call("/slidectl/sleep", {"duration": 1.0}))
        await asyncio.sleep(0)
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task
        await caller.flush()

    run(daemon, main)


def test_a_restricted_client_is_refused_the_rest(daemon: Runtime) -> None:
    async def main(client: AsyncClient) -> None:
        await client.set_node("/reader")
        assert client.node == "/reader"
        with pytest.raises(Refused, match="effects"):
            await client.restrict("red")
        await client.restrict("reads")
        with pytest.raises(Refused, match="not permitted"):
            await client.call("/slidectl/step")

    run(daemon, main)


def test_the_end_of_the_daemon_ends_what_waits(runtime: Runtime) -> None:
    runtime.start()
    lost: list[bool] = []

    async def main() -> None:
        async with AsyncClient(socket=runtime.paths.socket_text) as client:
            client.on_lost = lambda: lost.append(True)
            clock = await client.subscribe("/async/never", "std_msgs/Int32")
            waits = [
                asyncio.create_task(clock.get(30)),
                asyncio.create_task(client.call("/slidectl/sleep", {"duration": 1e6})),
            ]
            await client.call("/slidectl/shutdown")
            for wait in waits:
                with pytest.raises(NoDaemon, match="the daemon went away: the daemon was asked to stop"):
                    await wait
            assert not client.is_open
            with pytest.raises(NoDaemon):
                await client.call("/slidectl/status")

    asyncio.run(main())
    assert lost == [True]


def test_what_the_daemon_sent_before_its_end_is_read_after_it_too(runtime: Runtime) -> None:
    runtime.start()

    async def main() -> None:
        async with AsyncClient(socket=runtime.paths.socket_text) as client:
            answers: list[Any] = []
            await client.subscribe("/async/last", "std_msgs/Int32", take=answers.append)
            with runtime.client() as other:
                other.publish("/async/last", {"data": 1})
                other.flush()
            runtime.stop()  # this task does not wait meanwhile, so nothing is read
            with pytest.raises(NoDaemon, match="the daemon went away: the daemon was"):
                await client.call("/slidectl/status")
            assert [published["msg"] for published in answers] == [{"data": 1}]

    asyncio.run(main())


def test_without_a_daemon_it_says_how_to_start_one(runtime: Runtime) -> None:
    async def main() -> None:
        async with AsyncClient(socket=runtime.paths.socket_text):
            pass

    with pytest.raises(NoDaemon, match="no daemon answers on"):
        asyncio.run(main())
