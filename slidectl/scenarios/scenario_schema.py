"""The JSON schema of scenario files, from the tables that the check uses: editors complete and check with it."""

from __future__ import annotations

import json
from collections.abc import Mapping
from copy import deepcopy
from typing import Any

from slidectl.scenarios.scenario_file import (
    BASELINE_KEYS,
    CASE_KEYS,
    KINDS,
    SCENARIO_KEYS,
    STEP_KEYS,
    WORLD_KEYS,
    Key,
)
from slidectl.scenarios.step_commands import Commands, StepCommand, StepOption

_VALUE = {"type": ["string", "number", "boolean"]}
_TYPES: dict[str, dict[str, Any]] = {
    "flag": {"type": "boolean"},
    "integer": {"type": ["integer", "string"]},
    "number": {"type": ["number", "string"]},
    "text": _VALUE,
}


def as_text(commands: Commands) -> str:
    """The schema as text."""
    return json.dumps(schema(commands), indent=1, ensure_ascii=False) + "\n"


def schema(commands: Commands) -> dict[str, Any]:
    """A JSON schema (draft 2020-12)."""
    table = _object(SCENARIO_KEYS, required=["steps"])
    rows = table["properties"]["cases"]["items"]
    rows["properties"] = _properties(CASE_KEYS)
    tops = {command.split()[0] for command in commands.known}
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "A scenario of slidectl test",
        **table,
        "$defs": {
            "world": _object(WORLD_KEYS),
            "baseline": _object(BASELINE_KEYS),
            "step": {
                "anyOf": [
                    {"type": "string", "description": "A whole command line."},
                    {
                        "type": "object",
                        "properties": {
                            **_properties(STEP_KEYS),
                            **{
                                top: _VALUE | {"type": [*_VALUE["type"], "null", "array", "object"]}
                                for top in sorted(tops)
                            },
                            **{name: _command(command) for name, command in commands.known.items()},
                        },
                        "additionalProperties": False,
                        "minProperties": 1,
                    },
                ]
            },
        },
    }


def _object(keys: Mapping[str, Key], **more: Any) -> dict[str, Any]:
    return {"type": "object", "properties": _properties(keys), "additionalProperties": False, **more}


def _properties(keys: Mapping[str, Key]) -> dict[str, Any]:
    found = {}
    for name, key in keys.items():
        shape = deepcopy(KINDS[key.kind][2])
        if keys is STEP_KEYS and shape.get("type") in ("number", "boolean"):  # a variable may stand for it
            shape["type"] = [shape["type"], "string"]
        found[name] = {"description": key.help, **shape}
    return found


def _command(command: StepCommand) -> dict[str, Any]:
    inside: dict[str, Any] = {}
    for argument in command.arguments:
        inside[argument.name] = {"type": ["string", "number", "boolean", "array", "object", "null"]}
    for option in command.options:
        inside[option.name] = {"description": option.help, **_option(option)}
    required = [argument.name for argument in command.arguments if argument.required]
    return {
        "description": command.help,
        "anyOf": [
            {"type": ["string", "number", "boolean", "null", "array"]},
            {
                "type": "object", "properties": inside, "additionalProperties": False,
                **({"required": required} if required else {}),
            },
        ],
    }  # fmt: skip


def _option(option: StepOption) -> dict[str, Any]:
    one = {"enum": list(option.choices)} if option.choices else dict(_TYPES[option.kind])
    return {"anyOf": [one, {"type": "array", "items": one}]} if option.takes_several else one
