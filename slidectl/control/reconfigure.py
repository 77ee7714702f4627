"""Values that clients change by dynamic_reconfigure: the service and the two latched topics of one namespace.

The owner of the values defines them and the effect of a change. Ranges apply to requests of this service, not to the
values of parameter files.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import isnan
from typing import ClassVar, NamedTuple

from slidectl.control.node_handle import Message, NodeHandle
from slidectl.errors import Refused, UnknownName

Values = dict[str, float | bool]
_GROUP = {"name": "Default", "id": 0, "parent": 0}


class Option(NamedTuple):
    """One value: a number with its range, or a flag."""

    name: str
    description: str
    default: float | bool
    minimum: float | bool = False
    maximum: float | bool = True

    @property
    def is_flag(self) -> bool:
        """True for a flag, False for a number."""
        return isinstance(self.default, bool)


class ReconfigureServer:
    """Serves values in the namespace of a node handle."""

    saved_attributes: ClassVar[None] = None

    def __init__(
        self,
        node: NodeHandle,
        options: Sequence[Option],
        values: Callable[[], Values],
        change: Callable[[Values], None],
    ) -> None:
        """`values` returns the present values. `change` sets all values, and raises SlidectlError to refuse."""
        self._options = {option.name: option for option in options}
        self._values = values
        self._change = change
        node.advertise_service("set_parameters", "dynamic_reconfigure/Reconfigure", self._reconfigure)
        descriptions = node.advertise("parameter_descriptions", "dynamic_reconfigure/ConfigDescription", latch=True)
        descriptions.publish(self._description())
        self._updates = node.advertise("parameter_updates", "dynamic_reconfigure/Config", latch=True)

    def publish(self) -> None:
        """Publish the present values."""
        self._updates.publish(_config(self._values()))

    def _reconfigure(self, request: Message) -> Message:
        self._change(self._merged(request["config"]))
        return {"config": _config(self._values())}

    def _merged(self, config: Message) -> Values:
        """The present values with the changes of a Config message, all clipped to their ranges.

        Raises:
            UnknownName: no such value. Refused: nan, or a value of another type.
        """
        if config["ints"] or config["strs"]:
            raise Refused("only doubles and bools can be set, not ints or strs")
        values = self._values()
        for kind in ("doubles", "bools"):
            for entry in config[kind]:
                known = [option.name for option in self._options.values() if option.is_flag == (kind == "bools")]
                if entry["name"] not in known:
                    raise UnknownName(kind.removesuffix("s"), entry["name"], known)
                if isnan(entry["value"]):
                    raise Refused(f"{entry['name']} must be a number, not nan")
                values[entry["name"]] = entry["value"]
        return {
            name: value if option.is_flag else min(max(value, option.minimum), option.maximum)
            for name, option in self._options.items()
            for value in (values[name],)
        }

    def _description(self) -> Message:
        options = self._options.values()
        parameters = [
            {
                "name": option.name,
                "type": "bool" if option.is_flag else "double",
                "level": 1,
                "description": option.description,
                "edit_method": "",
            }
            for option in options
        ]
        return {
            "groups": [{**_GROUP, "type": "", "parameters": parameters}],
            "max": _config({option.name: option.maximum for option in options}),
            "min": _config({option.name: option.minimum for option in options}),
            "dflt": _config({option.name: option.default for option in options}),
        }


def _config(values: Values) -> Message:
    """The values as dynamic_reconfigure/Config."""
    return {
        "bools": [{"name": name, "value": value} for name, value in values.items() if isinstance(value, bool)],
        "ints": [],
        "strs": [],
        "doubles": [{"name": name, "value": value} for name, value in values.items() if not isinstance(value, bool)],
        "groups": [{**_GROUP, "state": True}],
    }
