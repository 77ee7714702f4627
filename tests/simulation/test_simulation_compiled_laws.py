"""The laws, compiled as the engine compiles them, against the recordings and against the interpreter, to the bit."""

from __future__ import annotations

import json
import random
import struct
from collections import Counter
from collections.abc import Callable
from inspect import signature
from math import inf, nan
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

numba = pytest.importorskip("numba")

from slidectl.control import angular_distance, limits  # noqa: E402
from slidectl.control.duration import from_seconds, to_seconds  # noqa: E402
from slidectl.control.hardware_interface import JointHandle  # noqa: E402
from slidectl.control.laws import Columns  # noqa: E402
from slidectl.control.limits import JointLimits, LimitHandle, SoftJointLimits  # noqa: E402
from slidectl.control.pid import Pid, next_command, next_command_from, pid_law  # noqa: E402
from slidectl.physics import robot_hw  # noqa: E402
from slidectl.physics.applied_forces import truncated  # noqa: E402
from slidectl.physics.robot_hw import Drive  # noqa: E402
from slidectl.simulation.compiled import tables  # noqa: E402
from slidectl.simulation.compiled.compiler import column_type, register_laws  # noqa: E402

DATA = Path(__file__).parent.parent / "data"
SCALAR_LAWS = [
    pid_law,
    truncated,
    to_seconds,
    limits.bounded,
    limits.bounded_twice,
    angular_distance.normalize_angle,
    angular_distance.shortest_angular_distance,
    angular_distance.unwrapped,
    angular_distance.two_pi_complement,
    angular_distance.distance_with_large_limits,
    angular_distance.distance_with_limits,
]
VALUES = (
    0.0,
    -0.0,
    1.0,
    -1.0,
    3.141592653589793,
    -3.141592653589793,
    6.283185307179586,
    1e-300,
    5e-324,
    1e300,
    inf,
    -inf,
    nan,
)


@pytest.fixture(scope="module", autouse=True)
def _taught() -> None:
    register_laws()


def bits(value: Any) -> Any:
    """Comparable to the bit; every nan is like another."""
    if isinstance(value, tuple):
        return tuple(map(bits, value))
    return "nan" if value != value else struct.pack("<d", value)


class Rows:
    """One object in one row, as compiled laws see it."""

    def __init__(self, columns: Columns, source: object) -> None:
        self._columns = columns
        self._memory = bytearray(columns.size)
        self.array: Any = np.frombuffer(self._memory, column_type(columns))
        self._source = source
        self.fill()

    def fill(self) -> None:
        places = (0.0,) * (len(self._columns.names) - len(self._columns.attributes))
        self._columns.fill(self._memory, 0, self._source, *map(int, places))

    def give(self) -> None:
        self._columns.give(self._memory, 0, self._source)


def compiled(law: Callable[..., Any]) -> Callable[..., Any]:
    """The law with a table in the place of its first argument, of which it takes the first row."""
    return numba.njit(lambda one, *rest: law(one[0], *rest))  # type: ignore[no-any-return]


def recorded(name: str) -> list[dict[str, Any]]:
    cases: list[dict[str, Any]] = json.loads((DATA / name).read_text())["cases"]
    return cases


def test_every_recorded_pid_comes_out_of_the_compiled_law() -> None:
    laws = {"error": compiled(next_command)}
    other = compiled(next_command_from)
    for case in recorded("pid_vectors.json"):
        gains = {key: float(value) for key, value in case["gains"].items() if key != "antiwindup"}
        pid = Pid(**gains, antiwindup=bool(case["gains"]["antiwindup"]))
        row = Rows(Pid.columns, pid)
        operations = {"reset": pid.reset, "reset2": pid.reset_to, "setGains": lambda *g, pid=pid: _set_gains(pid, g)}
        for k, inputs in enumerate(case["inputs"]):
            for operation in case["ops"]:
                if operation["before_input"] == k:
                    operations[operation["op"]](*map(float, operation["args"]))
                    row.fill()
            *errors, _ = map(float, inputs)
            computed = laws.get(case["mode"], other)(row.array, *errors, to_seconds(case["dt_ns"][k]))
            row.give()
            assert bits(computed) == bits(float(case["outputs"][k])), case["name"]
            state = (pid.p_error, pid.i_error, pid.d_error, pid.command)
            assert bits(state) == bits(tuple(map(float, case["state_after"][k]))), case["name"]


def _set_gains(pid: Pid, gains: tuple[float, ...]) -> None:
    pid.p, pid.i, pid.d, pid.i_max, pid.i_min = gains[:5]
    pid.antiwindup = bool(gains[5])


def test_every_recorded_limit_comes_out_of_the_compiled_law() -> None:
    machine = numba.njit(lambda limit, joint, period_s: limits.enforce(limit[0], joint[0], period_s))
    seen: Counter[str] = Counter()
    for case in recorded("joint_limits_vectors.json"):
        joint = JointHandle("joint")
        hard = JointLimits(**{k: v if isinstance(v, bool) else float(v) for k, v in case["limits"].items()})
        soft = SoftJointLimits(**{key: float(value) for key, value in case.get("soft_limits", {}).items()})
        kind = [each.name for each in limits.LIMIT_KINDS].index(case["handle"].removesuffix("Handle"))
        handle = LimitHandle(kind, joint, hard, soft)
        limit_row, joint_row = Rows(LimitHandle.columns, handle), Rows(tables.JOINT, joint)
        for k, (step, output) in enumerate(zip(case["steps"], case["outputs"], strict=True)):
            if k in case["resets"]:
                handle.reset()
                limit_row.fill()
            joint.position, joint.velocity, joint.effort, joint.command, period_s = map(float, step)
            joint_row.fill()
            machine(limit_row.array, joint_row.array, to_seconds(from_seconds(period_s)))
            joint_row.give()
            assert bits(joint.command) == bits(float(output)), case["handle"]
        seen[case["handle"]] += 1
    assert len(seen) == len(limits.LIMIT_KINDS)


@pytest.mark.parametrize("kind", range(len(limits.LIMIT_KINDS)))
def test_what_a_limit_makes_of_a_command_is_the_same_to_the_bit(kind: int) -> None:
    machine = numba.njit(lambda limit, joint, dt: limits.enforce(limit[0], joint[0], dt))
    dice = random.Random(kind)

    def number() -> float:
        return dice.choice(VALUES) if dice.random() < 0.3 else dice.uniform(-8, 8)

    for _ in range(2000):
        limit: Any = SimpleNamespace(**{name: number() for name in LimitHandle.columns.attributes})
        vars(limit).update(kind=kind, **{name: dice.random() < 0.5 for name in vars(limit) if name.startswith("has_")})
        joint = JointHandle("joint", number(), number(), number(), number())
        period_s = number()
        limit_row, joint_row = Rows(LimitHandle.columns, limit), Rows(tables.JOINT, joint)
        machine(limit_row.array, joint_row.array, period_s)
        limits.enforce(limit, joint, period_s)
        expected = bits((joint.command, limit.previous))
        joint_row.give()
        limit_row.give()
        assert bits((joint.command, limit.previous)) == expected


@pytest.mark.parametrize(
    "kind", [robot_hw.EFFORT, robot_hw.VELOCITY, robot_hw.LENGTH, robot_hw.REVOLVING, robot_hw.TURNING]
)
def test_what_a_drive_makes_of_a_command_is_the_same_to_the_bit(kind: int) -> None:
    machine = numba.njit(lambda drive, pid, joint, dt: robot_hw.drive_effort(drive[0], pid[0], joint[0], dt))
    dice = random.Random(kind)
    drive: Any = SimpleNamespace(kind=kind, lower=-2.0, upper=1.5, limit=7.0, fastest=1.0)
    pid, joint = Pid(p=5.0, i=2.0, d=0.5, i_max=3.0, i_min=-1.0), JointHandle("joint")
    drive_row, pid_row, joint_row = Rows(Drive.columns, drive), Rows(Pid.columns, pid), Rows(tables.JOINT, joint)
    for _ in range(500):
        joint.position, joint.velocity, joint.command = (dice.uniform(-4, 4) for _ in range(3))
        joint_row.fill()
        computed = machine(drive_row.array, pid_row.array, joint_row.array, 0.001)
        assert bits(computed) == bits(robot_hw.drive_effort(drive, pid, joint, 0.001))


@pytest.mark.parametrize("law", SCALAR_LAWS, ids=lambda law: law.__name__)
def test_a_compiled_law_and_the_interpreter_agree_to_the_bit(law: Callable[..., Any]) -> None:
    machine = numba.njit(law)
    dice = random.Random(law.__name__)
    kinds = [parameter.annotation for parameter in signature(law).parameters.values()]
    draw = {
        "float": lambda: dice.choice(VALUES) if dice.random() < 0.3 else dice.uniform(-8, 8),
        "int": lambda: dice.randrange(-(10**12), 10**15),
        "bool": lambda: dice.random() < 0.5,
    }
    for _ in range(4000):
        arguments = [draw[kind]() for kind in kinds]
        assert bits(machine(*arguments)) == bits(law(*arguments)), arguments
