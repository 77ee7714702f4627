"""How `/gazebo` services answer: `success` and `status_message` instead of a failed call."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import TYPE_CHECKING

from slidectl.control.node_handle import Message
from slidectl.errors import SlidectlError
from slidectl.simulation.pending import Pending
from slidectl.simulation.services import Handler

if TYPE_CHECKING:
    from slidectl.simulation.node import GraphNode

Answer = tuple[str, Message]
"""What was done, and the other fields of the response."""


def provide(node: GraphNode, service: str, type_name: str, handler: Callable[[Message], Answer | Pending]) -> None:
    """Advertise `service`; errors of the handler, or of the Answer that it gives later, become `success: false`."""
    node.advertise_service(service, f"gazebo_msgs/{type_name}", answering(handler))


def answering(handler: Callable[[Message], Answer | Pending]) -> Handler:
    """The handler with its answer, or its error, in the shape of Gazebo's responses."""

    @wraps(handler)
    def answer(request: Message) -> Message | Pending:
        try:
            given = handler(request)
        except SlidectlError as error:
            return _failure(error)
        return _later(given) if isinstance(given, Pending) else _success(given)

    return answer


def _success(answer: Answer) -> Message:
    text, fields = answer
    return {**fields, "success": True, "status_message": text}


def _failure(error: SlidectlError) -> Message:
    return {"success": False, "status_message": str(error)}


def _later(given: Pending) -> Pending:
    """The response when the answer is there. Whoever asked and goes away cancels it."""
    response = Pending(on_cancel=given.cancel)

    def settle(done: Pending) -> None:
        response.resolve(_failure(done.error) if done.error is not None else _success(done.result()))

    given.then(settle)
    return response
