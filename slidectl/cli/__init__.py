"""The command line: it parses, calls the client and prints. No other room imports this one.

`entry` is the console script. It must stay cheap to import: the command's own module, YAML, rich and the
rest are imported inside the functions that need them.
"""

from __future__ import annotations

import gc
import os
import sys
from typing import NoReturn

_INTERRUPTED = 130
# New objects between two looks for garbage: more than a short command makes (a tenth of its time went into looking),
# and still few enough for one that follows a topic for days.
_GARBAGE_THRESHOLD = 100_000


def entry() -> NoReturn:
    """Run the command line of this process and leave with its exit code."""
    code = _INTERRUPTED
    gc.set_threshold(_GARBAGE_THRESHOLD)
    if None in (sys.stdin, sys.stdout, sys.stderr):
        _stand_in()
    try:
        from slidectl.cli.main import run

        code = run(sys.argv[1:])
    except KeyboardInterrupt:
        pass
    leave(code)


def _stand_in() -> None:
    """Put /dev/null in the place of standard streams that were closed, before a socket gets their number."""
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, mode, encoding="utf-8"))  # noqa: SIM115


def leave(code: int) -> NoReturn:
    """Flush and end the process at once: an orderly teardown of the interpreter costs more than most commands."""
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except (OSError, ValueError, KeyboardInterrupt):
            continue
    os._exit(code)
