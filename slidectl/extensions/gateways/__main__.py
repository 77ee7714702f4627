"""`python -m slidectl.extensions.gateways`: a gateway in the background. Standard input has what `start` wrote."""

import sys

from slidectl.extensions.gateways.process import main

sys.exit(main(sys.stdin.read()))
