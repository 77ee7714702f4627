"""The parameters of a node in ROS 2: its six services, on the parameters of the daemon under the node's name.

`/rrbot/joint1_position_controller/pid/p` is the parameter `pid.p` of the node `/rrbot/joint1_position_controller`.
"""

from __future__ import annotations

import json
import logging
import os
from collections.abc import Callable, Collection, Coroutine
from typing import Any

from slidectl import names
from slidectl.effects import Effect, NotPermitted
from slidectl.errors import Refused, SlidectlError, cut
from slidectl.extensions.gateways.daemon_connection import DaemonConnection
from slidectl.extensions.gateways.ros2.participant import Participant

_log = logging.getLogger(__name__)

_UNSET = "\0 no such parameter"
_LISTS = {bool: 6, int: 7, float: 8, str: 9}
"""Type of the elements of a list -> the number of its type in rcl_interfaces/msg/ParameterType."""
_ATTRIBUTES = {
    1: "bool_value", 2: "integer_value", 3: "double_value", 4: "string_value", 5: "byte_array_value",
    6: "bool_array_value", 7: "integer_array_value", 8: "double_array_value", 9: "string_array_value",
}  # fmt: skip
_INT64 = range(-(2**63), 2**63)


class ParameterServices:
    """The services of one node."""

    def __init__(self, node: str, participant: Participant, daemon: DaemonConnection) -> None:
        self._name = node
        self._participant = participant
        self._daemon = daemon
        self._made: list[Any] = []

    def open(self, node: Any) -> None:
        """Offer the services by this node of ours. Only in rclpy's thread."""
        from rcl_interfaces import srv

        for name, handler in (
            ("GetParameters", self._get),
            ("GetParameterTypes", self._types),
            ("SetParameters", self._set),
            ("SetParametersAtomically", self._set_atomically),
            ("DescribeParameters", self._describe),
            ("ListParameters", self._list),
        ):
            own = "".join(f"_{letter.lower()}" if letter.isupper() else letter for letter in name).lstrip("_")
            kind = getattr(srv, name)
            self._made.append(self._participant.offer(node, kind, f"~/{own}", self._handler(kind, handler)))

    def _handler(self, kind: Any, handler: Callable[[Any, Any], Coroutine[Any, Any, None]]) -> Any:
        async def answer(request: Any) -> Any:
            response = kind.Response()
            try:
                await handler(request, response)
            except Exception as error:  # every request is answered
                _log.warning("parameters of %s: %s", self._name, self._daemon.failure_of(error))
            return response

        return answer

    def close(self, node: Any) -> None:
        """End the services. Only in rclpy's thread."""
        for service in self._made:
            self._participant.withdraw(node, service)

    # --- the services ---------------------------------------------------------------------------------------------

    async def _get(self, request: Any, response: Any) -> None:
        values = await self._values()
        response.values = [_to_ros2(values.get(name, _UNSET)) for name in request.names]

    async def _types(self, request: Any, response: Any) -> None:
        values = await self._values()
        response.types = bytes(_type_of(values.get(name, _UNSET)) for name in request.names)

    async def _set(self, request: Any, response: Any) -> None:
        response.results = [await self._set_together([one]) for one in request.parameters]

    async def _set_atomically(self, request: Any, response: Any) -> None:
        response.result = await self._set_together(request.parameters)

    async def _describe(self, request: Any, response: Any) -> None:
        from rcl_interfaces.msg import ParameterDescriptor

        values = await self._values()
        kinds = {name: _type_of(values.get(name, _UNSET)) for name in request.names}
        response.descriptors = [
            ParameterDescriptor(name=name, type=kinds[name], dynamic_typing=True) for name in request.names
        ]

    async def _list(self, request: Any, response: Any) -> None:
        def is_listed(name: str, prefix: str) -> bool:
            if prefix and name != prefix and not name.startswith(f"{prefix}."):
                return False
            return not request.depth or name[len(prefix) :].strip(".").count(".") < int(request.depth)

        prefixes = request.prefixes or [""]
        found = [name for name in await self._values() if any(is_listed(name, prefix) for prefix in prefixes)]
        response.result.names = found
        response.result.prefixes = sorted({name.rpartition(".")[0] for name in found if "." in name})

    # --- inside ---------------------------------------------------------------------------------------------------

    async def _values(self) -> dict[str, Any]:
        """All parameters of the node that ROS 2 can hold, by their names there."""
        answer = await self._daemon.call("/rosapi/get_param", {"name": self._name, "default": json.dumps(_UNSET)})
        tree = json.loads(answer["value"])
        return dict(sorted(_leaves(tree))) if isinstance(tree, dict) else {}

    async def _set_together(self, parameters: Any) -> Any:
        """Set all of them or none. The daemon says why it refuses one."""
        from rcl_interfaces.msg import SetParametersResult

        try:
            wanted: dict[str, Any] = {}
            for one in parameters:
                wanted |= self._placed(one.name, _from_ros2(one.value))
            texts = [json.dumps(value) for value in wanted.values()]
            await self._daemon.call("/slidectl/set_params", {"names": list(wanted), "values": texts})
        except (SlidectlError, ValueError) as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _placed(self, name: str, value: Any) -> dict[str, Any]:
        """The parameters of the daemon, by full name, that a parameter of the node sets. Raises SlidectlError."""
        return {f"{self._name}/{name.replace('.', '/')}": value}


class ManagerParameterServices(ParameterServices):
    """The services of a controller manager, at which ROS 2 sets the type of a controller and the files of its
    parameters before it is loaded. Here they are parameters of the controller."""

    def __init__(
        self, node: str, participant: Participant, daemon: DaemonConnection, permitted: Collection[Effect]
    ) -> None:
        """`permitted`: what nodes of ROS 2 may do."""
        super().__init__(node, participant, daemon)
        self._permitted = permitted

    def _placed(self, name: str, value: Any) -> dict[str, Any]:
        namespace = names.parent(self._name)
        controller, _, own = name.rpartition(".")
        if controller and own == "type":
            return {f"{names.join(namespace, controller)}/type": value}
        placed = super()._placed(name, value)
        if controller and own == "params_file":
            if Effect.FILES not in self._permitted:
                raise NotPermitted(f"the parameter {name}", Effect.FILES, self._permitted)
            for file in [value] if isinstance(value, str) else value:
                placed |= _in_file(file, namespace, controller)
        return placed

    async def _values(self) -> dict[str, Any]:
        """Those of the manager, and the types of the controllers."""
        request = {"name": names.parent(self._name), "default": "{}"}
        tree = json.loads((await self._daemon.call("/rosapi/get_param", request))["value"])
        found = tree.items() if isinstance(tree, dict) else ()
        kinds = {f"{name}.type": one["type"] for name, one in found if isinstance(one, dict) and "type" in one}
        return {**await super()._values(), **{name: kind for name, kind in kinds.items() if isinstance(kind, str)}}


def _in_file(file: str, namespace: str, controller: str) -> dict[str, Any]:
    """The parameters of a controller in a file of ROS 2, by their full names in the daemon. Raises SlidectlError."""
    from slidectl.description import controllers_file
    from slidectl.description.parameter_trees import leaves

    if not os.path.isabs(file):
        raise Refused(f"the file {cut(file, 80)!r} has no absolute path, so it is not known where it is")
    tree = controllers_file.read(file)
    found: dict[str, Any] = {}
    for place in ("", f"**{namespace}".rstrip("/"), "**", namespace):
        values = controllers_file.at(tree, f"{place}/{controller}")
        if isinstance(values, dict):
            found |= {f"{names.join(namespace, controller)}/{name}": value for name, value in leaves(values)}
    if not found:
        raise Refused(f"no parameters of {controller} in {file}", f"they are below '{controller}: ros__parameters:'")
    return found


def _leaves(tree: dict[str, Any], prefix: str = "") -> list[tuple[str, Any]]:
    found = []
    for name, value in tree.items():
        if isinstance(value, dict):
            found += _leaves(value, f"{prefix}{name}.")
        elif _type_of(value):
            found.append((prefix + name, value))
    return found


def _type_of(value: Any) -> int:
    """The number of a value's type in rcl_interfaces/msg/ParameterType; 0 for what ROS 2 cannot hold."""
    if isinstance(value, bool):
        return 1
    if isinstance(value, int):
        return 2 if value in _INT64 else 0
    if isinstance(value, float):
        return 3
    if isinstance(value, str):
        return 0 if value == _UNSET else 4
    if isinstance(value, list):
        kinds = {type(one) for one in value} or {str}
        if kinds == {int, float}:
            return _LISTS[float]
        has_type = len(kinds) == 1 and (kinds != {int} or all(one in _INT64 for one in value))
        return _LISTS.get(kinds.pop(), 0) if has_type else 0
    return 0


def _to_ros2(value: Any) -> Any:
    from rcl_interfaces.msg import ParameterValue

    kind = _type_of(value)
    made = ParameterValue(type=kind)
    if kind:
        setattr(made, _ATTRIBUTES[kind], [float(one) for one in value] if kind == _LISTS[float] else value)
    return made


def _from_ros2(value: Any) -> Any:
    """The value as the daemon has it. Raises ValueError: it is not set, which deletes no parameter here."""
    if value.type not in _ATTRIBUTES:
        raise ValueError("a parameter cannot be deleted by setting it to nothing: slidectl param delete")
    given = getattr(value, _ATTRIBUTES[value.type])
    if value.type == 5:
        return [int.from_bytes(one, "little") for one in given]
    return list(given) if value.type > 5 else given
