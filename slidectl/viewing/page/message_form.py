"""Inputs for the fields of a message, and the message that they make: as `slidectl pub` makes it of the same values."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

from slidectl.errors import UsageError
from slidectl.msgs.fill import Time, field_paths, fill
from slidectl.msgs.message_expressions import Numbers
from slidectl.msgs.schema import FLOATS, SCALAR, Field, Schema
from slidectl.values import read
from slidectl.viewing.page.page import Page

_MOST_STEPS = 10_000
"""Of an expression, while which the page does nothing else."""

Maker = Callable[[int, float, Time], dict[str, Any]]
"""Makes the message of an i and a t (s), at a simulated time."""


class MessageForm:
    """One input a field, nested ones as `a.b`: a box for a bool, else text, in the container that is entered.

    Numbers may be expressions in i and t, times `now`; arrays are YAML, of expressions too. What is left empty takes
    its default.
    """

    def __init__(self, page: Page, schema: Schema, chosen: dict[str, str | bool]) -> None:
        """`chosen` are the texts by path, and is written to: another form of the type begins with them."""
        self._schema = schema
        self._chosen = chosen
        self._fields = {path: _field(schema, path) for path in field_paths(schema.fields, schema.root)}
        gui = page.server.gui
        for path, field in self._fields.items():
            value = chosen.setdefault(path, _initial(field))
            handle = (
                gui.add_checkbox(path, value)
                if isinstance(value, bool)
                else gui.add_text(path, value, hint=field.type_text)
            )
            page.acting(handle, partial(chosen.__setitem__, path))

    def maker(self) -> Maker:
        """Of what is in the inputs now. Raises UsageError: text that is no YAML.

        The maker raises UsageError, Refused: a text is no expression, or cannot be computed; BadMessage.
        """
        values: dict[str, Any] = {}
        for path, field in self._fields.items():
            text = self._chosen[path]
            if text == "":
                continue
            *parents, name = path.split(".")
            inside = values
            for parent in parents:
                inside = inside.setdefault(parent, {})
            is_text = isinstance(text, bool) or (field.type == "string" and field.array == SCALAR)
            try:
                inside[name] = text if is_text else read(str(text))
            except UsageError as error:
                raise UsageError(f"{path}: {error.message}", error.hint) from None
        schema, numbers = self._schema, Numbers(expressions=True, most_steps=_MOST_STEPS)
        return lambda i, t, now: fill(schema.fields, schema.root, [values], now, numbers.at(i, t))


def _field(schema: Schema, path: str) -> Field:
    found = Field("", schema.root)
    for name in path.split("."):
        found = next(field for field in schema.fields(found.type) if field.name == name)
    return found


def _initial(field: Field) -> str | bool:
    if field.array != SCALAR:
        return "" if field.array else "[]"
    if field.type == "bool":
        return False
    return "" if field.type == "string" else "0.0" if field.type in FLOATS else "0"
