"""`rosclean`: refused, because there are no logs to clean."""

from __future__ import annotations

from collections.abc import Sequence

from slidectl.cli import output
from slidectl.cli.context import Context
from slidectl.cli.ros.failure import Failure

_USAGE = """usage: rosclean [-h] {check,purge} ...

Of ROS's logs it shows the size, or removes them. There are none here.
"""


def main(ctx: Context, argv: Sequence[str]) -> None:
    """Raises Failure, which says where the one log is; `-h` prints what the real one does."""
    if not {"-h", "--help"}.isdisjoint(argv):
        return output.write(_USAGE)
    raise Failure(
        f"rosclean: there is no folder of ROS logs here, and nothing to clean: the daemon's log {ctx.paths.log}\n"
        "is cut off by itself; see: slidectl daemon logs"
    )
