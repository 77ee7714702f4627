"""The step `still`: wait until no joint moves any more."""

from slidectl.errors import UsageError
from slidectl.extensions.scenarios import StepKind


class Still(StepKind):
    """`- still: 0.01` waits until no joint is faster than that."""

    help = "Wait until no joint is faster than this, in m/s or rad/s."
    schema = {"type": ["number", "string"], "exclusiveMinimum": 0}

    def check(self, value):
        if isinstance(value, bool) or not isinstance(value, int | float) or value <= 0:
            raise UsageError(f"a speed is a number above 0, not {value!r}", "- still: 0.01")

    def run(self, value, client):
        with client.subscribe("joint_states") as states:
            while True:
                fastest = max(map(abs, states.get()["velocity"]))
                if fastest < value:
                    return {"fastest": fastest}
