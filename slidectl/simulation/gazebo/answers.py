"""How `/gazebo` services answer: `success` and `status_message` instead of a failed call."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import TYPE_CHECKING

from slidectl.control.node import Message, ServiceHandler
from slidectl.errors import SlidectlError

if TYPE_CHECKING:
    from slidectl.simulation.node import GraphNode

Answer = tuple[str, Message]
"""What was done, and the other fields of the response."""


def provide(node: GraphNode, service: str, type_name: str, handler: Callable[[Message], Answer]) -> None:
    """Advertise `service`; errors of the handler become `success: false`."""
    node.advertise_service(service, f"gazebo_msgs/{type_name}", answering(handler))


def answering(handler: Callable[[Message], Answer]) -> ServiceHandler:
    """The handler with its answer, or its error, in the shape of Gazebo's responses."""

    @wraps(handler)
    def answer(request: Message) -> Message:
        try:
            text, fields = handler(request)
        except SlidectlError as error:
            return {"success": False, "status_message": str(error)}
        return {**fields, "success": True, "status_message": text}

    return answer
