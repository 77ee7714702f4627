"""`python -m slidectl.gateways`: a gateway's background process. It reads from standard input what `start` wrote."""

import sys

from slidectl.gateways.process import main

sys.exit(main(sys.stdin.read()))
