"""The parameters of a daemon as a mapping."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from slidectl import names
from slidectl.errors import UnknownName

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

    def set_all(self, values: Mapping[str, Any]) -> None:
        """Set several by full name, all or none. Raises Refused: a loaded controller cannot take a value."""
        texts = [json.dumps(value, allow_nan=False) for value in values.values()]
        self._client.call("/slidectl/set_params", {"names": list(values), "values": texts})

    def __delitem__(self, name: str) -> None:
        full = self._client.resolve("parameter", name)["name"]
        self._client.call("/rosapi/delete_param", {"name": full})

    def names(self) -> list[str]:
        """The full names, sorted."""
        return sorted(self._client.call("/rosapi/get_param_names")["names"])
