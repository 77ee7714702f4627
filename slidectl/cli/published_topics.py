"""Finds the topic that a reader means, and says what must run first where there are no joint states."""

from __future__ import annotations

import re

from slidectl.cli.context import Context
from slidectl.cli.topic_streams import PUBLISHERS, Target, look_up
from slidectl.errors import UnknownName

_JOINT_STATES = re.compile(r"(^|/)joint_?states?(/|\[|$)")


def look_up_published(ctx: Context, text: str) -> Target:
    """The topic, and its field, that `text` means among those that somebody publishes. Raises as `look_up`."""
    try:
        return look_up(ctx, text, PUBLISHERS)
    except UnknownName as error:
        if _JOINT_STATES.search(text):
            from slidectl.cli.controller import step_to_joint_states

            error.hint = f"{error.hint}\n{step_to_joint_states(ctx)}"
        raise
