"""Services: checked on both sides, answered now or later, and what happens when somebody goes."""

from __future__ import annotations

from typing import Any

import pytest

from slidectl.errors import BadMessage, Refused, UnknownName
from slidectl.simulation.pending import Pending
from slidectl.simulation.services import Services

SET_BOOL = "std_srvs/SetBool"


@pytest.fixture
def services() -> Services:
    return Services()


def test_handlers_see_complete_requests_and_callers_complete_responses(services: Services) -> None:
    seen: list[Any] = []

    def handler(request: Any) -> Any:
        seen.append(request)
        return {"success": True}

    services.advertise("/set", SET_BOOL, "/sim", handler)
    assert services.call("/set").result() == {"success": True, "message": ""}
    assert seen == [{"data": False}]


def test_an_unknown_service_is_answered_with_what_exists(services: Services) -> None:
    services.advertise("/set", SET_BOOL, "/sim", lambda _: {})
    with pytest.raises(UnknownName, match="Did you mean '/set'"):
        services.call("/sett").result()


def test_a_wrong_request_never_reaches_the_handler(services: Services) -> None:
    services.advertise("/set", SET_BOOL, "/sim", lambda _: pytest.fail("called"))
    with pytest.raises(BadMessage, match="data"):
        services.call("/set", {"data": "yes"}).result()


def test_an_error_of_the_handler_fails_the_call(services: Services) -> None:
    def handler(_request: Any) -> Any:
        raise Refused("not today")

    services.advertise("/set", SET_BOOL, "/sim", handler)
    with pytest.raises(Refused, match="not today"):
        services.call("/set").result()


def test_an_answer_may_come_later(services: Services) -> None:
    inner = Pending()
    services.advertise("/set", SET_BOOL, "/sim", lambda _: inner)
    answers: list[Any] = []
    call = services.call("/set").then(lambda pending: answers.append(pending.result()))
    assert not call.done
    assert answers == []
    inner.resolve({"message": "done"})
    assert answers == [{"success": False, "message": "done"}]


def test_an_answer_of_the_wrong_shape_fails_the_call(services: Services) -> None:
    inner = Pending()
    services.advertise("/set", SET_BOOL, "/client", lambda _: inner)
    call = services.call("/set")
    inner.resolve({"sucess": True})
    with pytest.raises(BadMessage, match="sucess"):
        call.result()


def test_when_the_provider_goes_its_open_calls_fail(services: Services) -> None:
    dropped: list[bool] = []
    service = services.advertise("/set", SET_BOOL, "/client", lambda _: Pending(on_cancel=lambda: dropped.append(True)))
    call = services.call("/set")
    service.close()
    with pytest.raises(Refused, match="/client went away"):
        call.result()
    assert dropped == [True]
    assert not services.exists("/set")


def test_when_the_caller_goes_the_provider_is_told(services: Services) -> None:
    dropped: list[bool] = []
    services.advertise("/set", SET_BOOL, "/client", lambda _: Pending(on_cancel=lambda: dropped.append(True)))
    services.call("/set").cancel()
    assert dropped == [True]


def test_a_taken_name_is_refused(services: Services) -> None:
    services.advertise("/set", SET_BOOL, "/sim", lambda _: {})
    with pytest.raises(Refused, match="already provided by /sim"):
        services.advertise("/set", SET_BOOL, "/other", lambda _: {})
    assert services.node_of("/set") == "/sim"


def test_an_unknown_type_is_refused(services: Services) -> None:
    with pytest.raises(UnknownName, match="std_srvs/SetBol"):
        services.advertise("/set", "std_srvs/SetBol", "/sim", lambda _: {})


def test_a_pending_answer_is_settled_once() -> None:
    pending = Pending.of(1)
    pending.resolve(2)
    pending.reject(Refused("late"))
    pending.cancel()
    assert pending.result() == 1
    assert not pending.cancelled


def test_a_cancelled_answer_calls_nobody_back() -> None:
    called: list[Any] = []
    pending = Pending().then(called.append)
    pending.cancel()
    pending.resolve(1)
    pending.then(called.append)
    assert called == []
    with pytest.raises(RuntimeError):
        pending.result()
