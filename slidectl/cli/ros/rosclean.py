"""`rosclean`: refused, because there are no logs to clean."""

from __future__ import annotations

from collections.abc import Sequence

from slidectl.cli.context import Context
from slidectl.cli.ros.failure import Failure


def main(ctx: Context, argv: Sequence[str]) -> None:  # noqa: ARG001
    """Raises Failure, which says where the one log is."""
    raise Failure(
        f"rosclean: there is no folder of ROS logs here, and nothing to clean: the daemon's log {ctx.paths.log}\n"
        "is cut off by itself; see: slidectl daemon logs"
    )
