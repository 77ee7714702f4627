"""Writes slidectl/msgs/typed.py: the messages that slidectl's code reads and writes most, as typed dicts for mypy.

python scripts/typed_messages.py [--check]

`--check` only compares.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

from slidectl import msgs
from slidectl.msgs.schema import BYTES, FLOATS, INTEGER_RANGES, SCALAR, Field

MODULE = Path(__file__).parent.parent / "slidectl" / "msgs" / "typed.py"

CALLED = {
    "/gazebo/delete_model": "gazebo_msgs/DeleteModel",
    "/rosapi/get_param": "rosapi/GetParam",
    "/rosapi/get_param_names": "rosapi/GetParamNames",
    "/rosapi/services": "rosapi/Services",
    "/rosapi/topics": "rosapi/Topics",
    "/slidectl/joint_states": "slidectl/JointStates",
    "/slidectl/list_robots": "slidectl/ListRobots",
    "/slidectl/spawn": "slidectl/Spawn",
    "/slidectl/scene": "slidectl/Scene",
    "/slidectl/set_params": "slidectl/SetParams",
    "/slidectl/snapshots": "slidectl/ListSnapshots",
    "/slidectl/status": "slidectl/Status",
    "/slidectl/step": "slidectl/Step",
    "/slidectl/update_times": "slidectl/ListUpdateTimes",
}
"""Service -> type, of the services whose answers `Client.call` types."""
SERVICES = (
    "controller_manager_msgs/ListControllers", "controller_manager_msgs/ListControllerTypes", "slidectl/Resolve",
)  # fmt: skip
"""Types of services that have other names in each namespace, or a method of their own."""
UNTYPED = dict.fromkeys(("geometry_msgs/Pose", "rosapi/TypeDef"), "dict[str, Any]")
"""Parts that one module alone reads."""

HEAD = '''"""Messages as typed dicts, for type checkers only: import it under TYPE_CHECKING.

Written by `python scripts/typed_messages.py` from the definitions in `data`. A float that is not a number reaches a
client as None.
"""

# mypy: disable-error-code="overload-overlap"

from __future__ import annotations

from typing import Any, Literal, Protocol, TypedDict, overload

Request = dict[str, Any] | None
'''

CALL = '''

class Call(Protocol):
    """`Client.call`: a known service returns its own response."""
'''
OVERLOAD = """
    @overload
    def __call__(
        self, service: {service}, request: Request = None, *, timeout: float | None = None
    ) -> {response}: ...
"""
END = """
    @overload
    def __call__(self, service: str, request: Request = None, *, timeout: float | None = None) -> dict[str, Any]: ...
"""


def class_name(type_name: str) -> str:
    """`slidectl/RobotInfo` -> `RobotInfoMsg`."""
    return type_name.partition("/")[2] + "Msg"


def python_type(field: Field) -> str:
    """The annotation of a field."""
    if field.array != SCALAR and field.type in BYTES:
        return "str"
    simple = {"bool": "bool", "string": "str", **dict.fromkeys(INTEGER_RANGES, "int"), **dict.fromkeys(FLOATS, "float")}
    one = (simple | UNTYPED).get(field.type) or class_name(field.type)
    return one if field.array == SCALAR else f"list[{one}]"


def with_parts(type_name: str, listed: dict[str, tuple[Field, ...]]) -> None:
    """Add a type after the types of its fields."""
    if type_name not in listed:
        fields = msgs.fields(type_name)
        for field in fields:
            if field.type not in UNTYPED and msgs.exists(field.type):
                with_parts(field.type, listed)
        listed[type_name] = fields


def module() -> str:
    """The text of the module."""
    types: dict[str, tuple[Field, ...]] = {}
    for name in map(msgs.response_type, (*CALLED.values(), *SERVICES)):
        with_parts(name, types)
    calls = {f'Literal["{service}"]': class_name(msgs.response_type(type)) for service, type in CALLED.items()}
    overloads = (OVERLOAD.format(service=service, response=response) for service, response in calls.items())
    return "".join([HEAD, *class_texts(types), CALL, *overloads, END])


def class_texts(types: dict[str, tuple[Field, ...]]) -> Iterator[str]:
    """Each class, with blank lines before it."""
    names = [class_name(type_name) for type_name in types]
    if len(set(names)) < len(names):
        raise SystemExit(f"two types have the same class name: {sorted(names)}")
    for name, fields in zip(names, types.values(), strict=True):
        yield f"\n\nclass {name}(TypedDict):\n"
        yield from (f"    {field.name}: {python_type(field)}\n" for field in fields)


def main() -> None:
    """Write the module, or compare it."""
    text = module()
    if "--check" not in sys.argv[1:]:
        MODULE.write_text(text)
    elif MODULE.read_text() != text:
        sys.exit("slidectl/msgs/typed.py is not up to date; run: python scripts/typed_messages.py")


if __name__ == "__main__":
    main()
