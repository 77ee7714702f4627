"""The command line: it parses, calls the client and prints. No other room imports this one.

`entry` is the console script. It must stay cheap to import: the command's own module, YAML, rich and the
rest are imported inside the functions that need them.
"""

from __future__ import annotations

import gc
import os
import sys
from contextlib import suppress
from typing import TYPE_CHECKING, NoReturn

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

_INTERRUPTED = 130


def entry() -> NoReturn:
    """Run the command line of this process and leave with its exit code."""
    code = _INTERRUPTED
    with suppress(KeyboardInterrupt):
        code = _imported_run()(sys.argv[1:])
    leave(code)


def _imported_run() -> Callable[[Sequence[str]], int]:
    """The function that runs a command line. What is imported is no garbage, so none is looked for meanwhile."""
    gc.disable()
    from slidectl.cli.main import run

    gc.freeze()
    gc.enable()
    return run


def leave(code: int) -> NoReturn:
    """Flush and end the process at once: an orderly teardown of the interpreter costs more than most commands."""
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except (OSError, ValueError, KeyboardInterrupt):
            continue
    os._exit(code)
