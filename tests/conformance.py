"""Run files of recorded vectors through the public control classes and compare.

Usage: python tests/conformance.py FILE.json ...   Prints the worst deviation of each file. Exit code: 0 all equal,
1 a mismatch, 2 a file that cannot be read. Formats: PID, joint limits and transmission vectors, which are to agree to
the bit, and whole runs of controllers (recorded_run.py), which are to agree within 1e-9.
"""

from __future__ import annotations

import json
import re
import struct
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from math import inf, isfinite, isnan
from pathlib import Path
from typing import Any

# A checkout runs as it stands, installed or not.
sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from recorded_run import TOLERANCE, last_cycle, replay

from slidectl.control import limits as limit_handles
from slidectl.control import transmission_interface as transmissions
from slidectl.control.duration import from_seconds, to_seconds
from slidectl.control.hardware_interface import JointHandle
from slidectl.control.limits import JointLimits, SoftJointLimits
from slidectl.control.pid import Gains, Pid, next_command_from
from slidectl.errors import SlidectlError

Case = dict[str, Any]
Comparison = tuple[str, Any, Any]
"""Where, what was recorded, what came out."""


class Unreadable(Exception):
    """A file that is missing, broken or of no known format."""


@dataclass
class Outcome:
    """What came of one file."""

    cases: int = 0
    values: int = 0
    worst: float = 0.0
    mismatches: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def compare(self, where: str, recorded: Any, computed: Any, tolerance: float | None = None) -> None:
        """Count one value; unequal bits (every nan is like another), or more than the tolerance, are a mismatch."""
        self.values += 1
        if tolerance is not None and recorded in ("nan", "inf", "-inf"):
            recorded = float(recorded)
        are_numbers = isinstance(recorded, int | float) and isinstance(computed, int | float)
        if same_bits(recorded, computed) if are_numbers else recorded == computed:
            return
        deviation = abs(recorded - computed) if are_numbers else inf
        self.worst = max(self.worst, deviation if isfinite(deviation) else inf)
        if tolerance is None or not deviation <= tolerance:
            self.mismatches.append(f"{where}: recorded {recorded!r}, computed {computed!r}")


def same_bits(one: float, other: float) -> bool:
    """Equal to the bit, signed zeros too; nan equals nan."""
    return (isnan(one) and isnan(other)) or struct.pack("<d", one) == struct.pack("<d", other)


def number(value: Any) -> float:
    """A recorded number; non-finite ones are strings."""
    return float(value)


def numbers(values: Iterable[Any]) -> list[float]:
    """A list of recorded numbers."""
    return [number(value) for value in values]


# PID: gains, a sequence of inputs, outputs and the state after each.


def pid_case(case: Case) -> Iterator[Comparison]:
    """Every output and every state of one PID."""
    pid = Pid(**_gains(case["gains"])._asdict())
    operations = {
        "reset": pid.reset,
        "reset2": pid.reset_to,
        "setGains": lambda *gains: pid.set_gains(Gains(*gains[:5], antiwindup=bool(gains[5]))),
    }
    compute: Callable[..., float] = pid.compute_command if case["mode"] == "error" else partial(next_command_from, pid)
    for k, inputs in enumerate(case["inputs"]):
        for operation in case["ops"]:
            if operation["before_input"] == k:
                operations[operation["op"]](*numbers(operation["args"]))
        *errors, _ = numbers(inputs)
        computed = compute(*errors, to_seconds(case["dt_ns"][k]))
        yield f"output {k}", number(case["outputs"][k]), computed
        state = (pid.p_error, pid.i_error, pid.d_error, pid.command)
        for name, recorded, now in zip(
            ("p_error", "i_error", "d_error", "cmd"), case["state_after"][k], state, strict=True
        ):
            yield f"{name} after {k}", number(recorded), now


def _gains(recorded: Case) -> Gains:
    values = {name: number(recorded[name]) for name in ("p", "i", "d", "i_max", "i_min")}
    return Gains(**values, antiwindup=bool(recorded["antiwindup"]))


# Joint limits: one handle, step by step.


def limits_case(case: Case) -> Iterator[Comparison]:
    """Every command that one limit handle lets through."""
    joint = JointHandle("joint")
    handle = _limit_handle(case["handle"], joint, _limits(case["limits"]), _soft_limits(case.get("soft_limits", {})))
    for k, step in enumerate(case["steps"]):
        if k in case["resets"]:
            handle.reset()
        joint.position, joint.velocity, joint.effort, joint.command, period_s = numbers(step)
        handle.enforce(to_seconds(from_seconds(period_s)))
        yield f"command {k}", number(case["outputs"][k]), joint.command


def limits_refusal(text: str) -> bool:
    """Is the handle refused? `text` is like `EffortJointSaturationHandle with velocity and effort limits`."""
    kind, _, rest = text.partition(" with ")
    known = {f"has_{word}_limits": True for word in ("position", "velocity", "acceleration", "effort") if word in rest}
    return _refused(lambda: _limit_handle(kind, JointHandle("joint"), JointLimits(**known), SoftJointLimits()))


def _limit_handle(
    kind: str, joint: JointHandle, limits: JointLimits, soft: SoftJointLimits
) -> limit_handles.LimitHandle:
    which = [each.name for each in limit_handles.LIMIT_KINDS].index(kind.removesuffix("Handle"))
    return limit_handles.LimitHandle(which, joint, limits, soft if "Soft" in kind else None)


def _limits(recorded: Case) -> JointLimits:
    return JointLimits(
        **{name: value if isinstance(value, bool) else number(value) for name, value in recorded.items()}
    )


def _soft_limits(recorded: Case) -> SoftJointLimits:
    return SoftJointLimits(**{name: number(value) for name, value in recorded.items()})


# Transmissions: both directions.

_QUANTITIES = ("position", "velocity", "effort", "absolute_position", "torque_sensor")


def transmission_case(case: Case) -> Iterator[Comparison]:
    """Every joint value of the actuators' values, and the other way round."""
    transmission = _transmission(case)
    for source, target, to in (("actuator_in", "joint_out", "joint"), ("joint_in", "actuator_out", "actuator")):
        for quantity in (name for name in _QUANTITIES if name in case[target]):
            computed = getattr(transmission, f"{to}_{quantity}")(numbers(case[source][quantity]))
            for k, (recorded, value) in enumerate(zip(case[target][quantity], computed, strict=True)):
                yield f"{to} {quantity} {k}", number(recorded), value


def transmission_refusal(text: str) -> bool:
    """Is the transmission refused? `text` is like `simple reduction 0` or `four_bar joint_offset of size 3`."""
    kind, what, value = re.fullmatch(r"(\w+) (\w+) (?:of size )?(.+)", text).groups()  # type: ignore[union-attr]
    if kind == "simple":
        return _refused(lambda: transmissions.SimpleTransmission(number(value)))
    arguments = {"actuator_reduction": [2.0, 3.0], "joint_reduction": [2.0, 3.0], "joint_offset": [0.0, 0.0]}
    arguments[what] = [1.0] * int(value) if "of size" in text else numbers(json.loads(value))
    return _refused(lambda: _TWO_DOF[kind](**arguments))


_TWO_DOF: dict[str, Any] = {
    "differential": transmissions.DifferentialTransmission,
    "four_bar": transmissions.FourBarLinkageTransmission,
    "four_bar_linkage": transmissions.FourBarLinkageTransmission,
}


def _transmission(case: Case) -> transmissions.Transmission:
    reduction, offset = numbers(case["actuator_reduction"]), numbers(case["joint_offset"])
    if case["type"] == "simple":
        return transmissions.SimpleTransmission(reduction[0], offset[0])
    options = {"ignore_absolute_encoders": True} if case.get("ignore_abs") else {}
    made: transmissions.Transmission = _TWO_DOF[case["type"]](
        reduction, numbers(case["joint_reduction"]), offset, **options
    )
    return made


def _refused(make: Callable[[], object]) -> bool:
    try:
        make()
    except SlidectlError:
        return True
    return False


# Files.


@dataclass(frozen=True)
class Format:
    """How the cases of one kind of file are run; `key` is a field that only its cases have."""

    key: str
    run: Callable[[Case], Iterator[Comparison]]
    refusal: Callable[[str], bool] | None = None
    tolerance: float | None = None
    """None: to the bit."""


FORMATS = (
    Format("mode", pid_case),
    Format("handle", limits_case, limits_refusal),
    Format("actuator_reduction", transmission_case, transmission_refusal),
    Format("events", replay, tolerance=TOLERANCE),
)


def run_file(path: str) -> Outcome:
    """All cases of one file. Raises Unreadable."""
    try:
        with open(path, encoding="utf-8") as file:
            vectors = json.load(file)
        return run_vectors(vectors)
    except (OSError, ValueError, KeyError, TypeError, AttributeError, IndexError) as error:
        raise Unreadable(f"{path}: {type(error).__name__}: {error}") from error


def run_vectors(vectors: Case) -> Outcome:
    """All cases of one file's contents."""
    outcome = Outcome()
    for k, case in enumerate(vectors["cases"]):
        outcome.cases += 1
        form = _format_of(case)
        if form.run is replay and last_cycle(case) < case["cycles"]:
            text = f"compared up to cycle {last_cycle(case)} of {case['cycles']}; the next command is refused here"
            outcome.notes.append(f"case {case.get('name', k)}: {text}")
        for where, recorded, computed in form.run(case):
            outcome.compare(f"case {case.get('name', k)}, {where}", recorded, computed, form.tolerance)
    for refusal in vectors.get("constructor_errors", ()):
        outcome.cases += 1
        refused = _format_of(vectors["cases"][0]).refusal
        if refused is None:
            raise ValueError("this format has no constructor errors")
        outcome.compare(f"refusal of {refusal['case']}", refusal["raises"], refused(refusal["case"]))
    if outcome.cases == 0:
        raise ValueError("no cases")
    return outcome


def _format_of(case: Case) -> Format:
    for form in FORMATS:
        if form.key in case:
            return form
    raise ValueError(f"a case of no known format, with the fields {', '.join(case)}")


def main(paths: Sequence[str]) -> int:
    """Run the files and print one line for each. Returns the exit code."""
    code = 0
    for path in paths:
        try:
            outcome = run_file(path)
        except Unreadable as error:
            print(error, file=sys.stderr)
            code = 2
            continue
        print(
            f"{path}: {outcome.cases} cases, {outcome.values} values, {len(outcome.mismatches)} mismatches, "
            f"worst deviation {outcome.worst!r}"
        )
        for line in (*outcome.mismatches[:5], *outcome.notes):
            print(f"  {line}")
        if outcome.mismatches and code == 0:
            code = 1
    if not paths:
        print(__doc__, file=sys.stderr)
        code = 2
    return code


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
