"""`rossrv`: what service types are made of."""

from __future__ import annotations

from collections.abc import Sequence

from slidectl.cli.context import Context
from slidectl.cli.msg import services
from slidectl.cli.ros.type_tool import Types, tool

TOOL = tool("rossrv", "service type")
_TYPES = Types("rossrv", "service", "srv", services)
show, list_types, md5 = _TYPES.show, _TYPES.list_types, _TYPES.md5
package, packages = _TYPES.package, _TYPES.packages


def main(ctx: Context, argv: Sequence[str]) -> None:
    """Run a verb."""
    TOOL.run(ctx, argv)
