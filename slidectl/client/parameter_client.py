"""The parameters of a daemon as a mapping."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from slidectl import names
from slidectl.errors import UnknownName, UsageError

if TYPE_CHECKING:
    from slidectl.client.connection import GraphClient


class Params:
    """The parameters of a daemon. A value is a number, text, truth value or list, or a dict for a whole namespace.

    Names may be short, as on the command line; a new parameter's name is relative to the root namespace.
    """

    def __init__(self, client: GraphClient) -> None:
        self._client = client

    def __getitem__(self, name: str) -> Any:
        full = self._client.resolve("parameter", name)["name"]
        return json.loads(self._client.call("/rosapi/get_param", {"name": full})["value"])

    def get(self, name: str, default: Any = None) -> Any:
        """The value, or `default` when there is no such parameter."""
        try:
            return self[name]
        except UnknownName:
            return default

    def __setitem__(self, name: str, value: Any) -> None:
        try:
            full = self._client.resolve("parameter", name)["name"]
        except UnknownName:
            full = names.join("/", name)
        self.set_all({full: value})

    def set_all(self, values: Mapping[str, Any], known_only: bool = False) -> list[str]:
        """Set several by full name, all or none; other parameters stay. The client's `reasons` have warnings.

        Args:
            known_only: a name below a loaded controller that it does not read is an error.

        Returns:
            The names that were not set before, without those below a loaded controller, which has checked them.

        Raises:
            Refused: a loaded controller cannot take a value. UsageError: JSON cannot carry a value.
        """
        texts = [json_of(name, value) for name, value in values.items()]
        request = {"names": list(values), "values": texts, "known_only": known_only}
        answer = self._client.call("/slidectl/set_params", request)
        return [name for name in answer["created"] if name not in answer["guarded"]]

    def __delitem__(self, name: str) -> None:
        full = self._client.resolve("parameter", name)["name"]
        self._client.call("/rosapi/delete_param", {"name": full})

    def names(self) -> list[str]:
        """The full names, sorted."""
        return sorted(self._client.call("/rosapi/get_param_names")["names"])


def json_of(name: str, value: Any) -> str:
    """The value of a parameter as JSON. Raises UsageError when JSON cannot carry it."""
    try:
        return json.dumps(value, allow_nan=False)
    except ValueError:
        raise UsageError(f"parameter {name} cannot be set to {value}: parameters hold finite numbers") from None
