"""Values of parameters: as they are typed, as files hold them, and as YAML. Shared by all commands that set them."""

from __future__ import annotations

import json
import re
from typing import TYPE_CHECKING, Any

from slidectl.errors import BadFile, UsageError

if TYPE_CHECKING:
    from slidectl.cli.context import Context

_PLAIN_NUMBER = re.compile(r"-?\d+(\.\d+)?\Z")
_BEGINS_AS_LIST = re.compile(r"(\s*(#.*)?\n)*\s*(-\s|\[)")


def get(ctx: Context, full: str) -> Any:
    """The value, a dict for a namespace. Raises Refused when it is not set."""
    return json.loads(ctx.call("/rosapi/get_param", {"name": full})["value"])


def typed(text: str) -> Any:
    """What was typed: YAML, angles in radians, empty text for no text. Raises UsageError."""
    from slidectl.cli import values

    if "deg" not in text and "rad" not in text:
        return "" if text == "" else values.read(text)
    from slidectl.description import angles

    return values.read_yaml(text, values.shown(text), angles=True) if angles.may_be_in(text) else values.read(text)


def tree(ctx: Context, text: str, file: str, may_be_list: bool) -> Any:
    """The parameters in a text: a mapping; where a namespace names it, a list or text too. Raises BadFile."""
    from slidectl.description import yaml_tree

    if may_be_list and _BEGINS_AS_LIST.match(text) and not text.startswith("---"):
        return yaml_tree.read_value(text, file)
    notices: list[Any] = []
    try:
        content = yaml_tree.read(text, file, notices, rooted=True)
    except BadFile:
        bare = _bare(text, file) if may_be_list else None
        if bare is None:
            raise
        return bare
    for notice in notices:
        ctx.warn(f"{notice.file}:{notice.line}: {notice.subject} {notice.text}")
    return content


def _bare(text: str, file: str) -> str | None:
    """The text that is all there is in a file, which is how one parameter is dumped."""
    from slidectl.description import yaml_tree

    try:
        value = yaml_tree.read_value(text, file)
    except BadFile:
        return None
    return value if isinstance(value, str) else None


def dumped(value: Any) -> str:
    """The value as PyYAML writes it in block style, keys sorted. Common scalars are written without loading it."""
    text = _scalar(value)
    if text is not None:
        return f"{text}\n...\n"
    import yaml

    from slidectl.description import angles

    dumper: Any = type("Dumper", (yaml.SafeDumper,), {})
    angles.add_to(dumper)
    return str(yaml.dump(value, Dumper=dumper, default_flow_style=False))


def _scalar(value: Any) -> str | None:
    """The text of a scalar that needs neither quotes nor another notation than Python's."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        from slidectl.cli.yamlform import is_plain

        return value if is_plain(value) else None
    if isinstance(value, int | float) and _PLAIN_NUMBER.match(repr(value)):
        return repr(value)
    return None


def settings(content: Any, full: str) -> dict[str, Any]:
    """What to set for a value at `full`: a mapping one by one, so that it is merged, anything else as a whole.

    Raises UsageError for null, which no parameter can be.
    """
    from slidectl.client.spawning import leaves

    if content is None:
        raise UsageError("null is no value of a parameter", f"slidectl param delete {full}")
    return dict(leaves(content, full)) if isinstance(content, dict) and content else {full: content}
