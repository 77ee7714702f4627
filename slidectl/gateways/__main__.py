"""`python -m slidectl.gateways`: the process of a gateway in the background, which reads what `start` wrote."""

import sys

from slidectl.gateways.process import main

sys.exit(main(sys.stdin.read()))
