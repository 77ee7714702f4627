"""`python -m slidectl.daemon`: the process that `slidectl daemon start` starts and `slidectl daemon run` becomes."""

from __future__ import annotations

import os
import sys

from slidectl.daemon.process import main

if __name__ == "__main__":
    code = main(sys.argv[1:])
    # All is flushed and released; taking the interpreter and its libraries apart would only cost time.
    sys.stderr.flush()
    os._exit(code)
