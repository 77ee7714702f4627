"""Controllers of users, from files: what is wrong with a file is said with its line, and changes nothing."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from push_law import LAW
from sim_robots import STATES, cart, command, configure, drive_up, logged, state, states_of, switch

from slidectl import description
from slidectl.control import user_classes
from slidectl.errors import SlidectlError
from slidectl.simulation import Simulation
from slidectl.simulation.compiled.object_file import is_possible


class Bench:
    """A cart in a simulation, and a file of laws."""

    def __init__(self, file: Path) -> None:
        self.file = file
        self.simulation = Simulation()
        self.robot = self.simulation.spawn(cart(), "cart")
        self.write()

    def write(self, old: str = "", new: str = "") -> None:
        """The file holds the law that works, with `new` instead of `old`."""
        assert old in LAW
        self.file.write_text(LAW.replace(old, new, 1) if old else LAW, encoding="utf-8")

    def set(self, name: str, value: Any) -> None:
        self.simulation.parameters.set(f"/cart/my_law/{name}", value)

    def load(self, class_name: str = "Push") -> bool:
        request = {"robot": "cart", "name": "my_law", "file": str(self.file), "class_name": class_name}
        ok: bool = self.simulation.call("/slidectl/load_controller_file", request)["ok"]
        return ok

    def reload(self) -> bool:
        ok: bool = self.simulation.call("/slidectl/reload_controller", {"robot": "cart", "name": "my_law"})["ok"]
        return ok

    def states(self) -> dict[str, str]:
        return {one["name"]: one["state"] for one in self.robot.manager.list()}

    def effort(self) -> float:
        """What the law told last, two cycles later."""
        told: list[float] = []
        subscription = self.simulation.subscribe("/cart/my_law/told", lambda message: told.append(message["data"]))
        self.simulation.step(2)
        subscription.close()
        return told[-1]

    def reasons(self) -> str:
        """Of a load or reload that is refused. Nothing is left behind."""
        reasons: list[str] = []
        with self.simulation.graph.log.answering(reasons):
            assert not self.load()
        assert self.states() == {}
        assert not self.simulation.parameters.has("/cart/my_law/type")
        return "\n".join(reasons)


@pytest.fixture
def bench(tmp_path: Path) -> Bench:
    return Bench(tmp_path / "my_laws.py")


@pytest.fixture
def pushing(bench: Bench) -> Bench:
    """The law runs and pushes with 2 N."""
    bench.set("push", 2.0)
    assert bench.load()
    assert switch(bench.simulation, start=["my_law"])
    return bench


# -- load --------------------------------------------------------------------------------------------------------------


def test_the_class_need_not_be_named_when_the_file_has_one_controller(bench: Bench) -> None:
    assert bench.load("")
    assert bench.simulation.parameters.get("/cart/my_law/type") == "my_laws/Push"


def test_parameters_are_those_of_the_namespace_and_are_judged_like_any(pushing: Bench) -> None:
    assert pushing.effort() == 2.0
    with pytest.raises(SlidectlError, match="must be a number"):
        pushing.set("push", "much")


def test_it_is_loaded_again_by_its_type(bench: Bench) -> None:
    bench.load()
    bench.simulation.call("/cart/controller_manager/unload_controller", {"name": "my_law"})
    assert bench.simulation.call("/cart/controller_manager/load_controller", {"name": "my_law"})["ok"]


def test_a_file_imports_what_stands_beside_it(bench: Bench) -> None:
    bench.file.with_name("beside_a_law.py").write_text("FACTOR = 7.0\n")
    bench.write("\nJOINT", "from beside_a_law import FACTOR\nJOINT")
    assert bench.load()


# -- what is wrong with a file -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("old", "new", "line", "said"),
    [
        ("def init(self", "def init(self:", 12, "def init(self:, interface, node)"),
        (
            "time_ns, period_s",
            "time_ns",
            17,
            "Push.update has a wrong signature: (self, time_ns), but it is called",
        ),
        ("self, interface, node", "self", 12, "def init(self, interface, node): ..."),
        ("def update", "def updates", 8, "Push has no update"),
        ("    interface_type = EffortJointInterface\n", "", 8, "Push has no interface_type"),
        ("def init(", "def __init__(self, gain): pass\n\n    def init(", 12, "Push.__init__ has a wrong signature"),
        ("\nJOINT", "1 / 0\nJOINT", 3, "ZeroDivisionError: division by zero"),
        ("\nJOINT", "import no_such_thing\nJOINT", 3, "No module named 'no_such_thing'"),
        ("\nJOINT", "raise SystemExit(1)\nJOINT", 3, "SystemExit: 1"),
        ("class Push(Controller)", "class Push", 8, "Push is not a controller"),
    ],
)
def test_what_is_wrong_is_said_with_file_and_line(bench: Bench, old: str, new: str, line: int, said: str) -> None:
    bench.write(old, new)
    with pytest.raises(SlidectlError) as error:
        bench.load()
    assert str(error.value).startswith(f"{bench.file}:{line}: ")
    assert said in str(error.value)
    assert error.value.exit_code == 2
    assert bench.states() == {}
    assert not bench.simulation.parameters.has("/cart/my_law/type")


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("        self.told =", "        {}['gain']\n        self.told =", "KeyError: 'gain' (FILE:15)"),
        (
            "def init(",
            "def __init__(self): pass\n\n    def init(",
            "FILE:8: Push.__init__ does not call super()",
        ),
        ('"joint1"', '"elbow"', "no joint 'elbow'"),
    ],
)
def test_what_is_wrong_in_init_is_a_reason(bench: Bench, old: str, new: str, said: str) -> None:
    bench.write(old, new)
    assert said.replace("FILE", str(bench.file)) in bench.reasons()


def test_a_class_that_is_not_in_the_file(bench: Bench) -> None:
    with pytest.raises(SlidectlError, match=r"no controller class 'Pusch' in .* Did you mean 'Push'"):
        bench.load("Pusch")


def test_two_controllers_and_no_class_named(bench: Bench) -> None:
    bench.write()
    with bench.file.open("a") as file:
        file.write("\nclass Pull(Push):\n    pass\n")
    with pytest.raises(SlidectlError, match="has 2 controllers: Pull, Push"):
        bench.load("")


def test_a_name_that_is_taken(bench: Bench) -> None:
    bench.load()
    with pytest.raises(SlidectlError, match="it is loaded already\nslidectl controller reload my_law"):
        bench.load()


# -- edited ------------------------------------------------------------------------------------------------------------


def test_an_edited_law_runs_on_with_its_name_place_and_parameters(pushing: Bench) -> None:
    pushing.simulation.parameters.set("/cart/states", {"type": STATES, "publish_rate": 50})
    pushing.simulation.call("/cart/controller_manager/load_controller", {"name": "states"})
    for factor in (3, 4, 5):
        pushing.write("= self.push\n", f"= {factor} * self.push\n")
        assert pushing.reload()
        assert pushing.effort() == factor * 2.0
    assert pushing.states() == {"my_law": "running", "states": "initialized"}
    assert list(pushing.states()) == ["my_law", "states"]


def test_a_stopped_law_stays_stopped(pushing: Bench) -> None:
    switch(pushing.simulation, stop=["my_law"])
    assert pushing.reload()
    assert pushing.states() == {"my_law": "initialized"}


@pytest.mark.parametrize(
    ("old", "new"),
    [("def update(self", "def update(self:"), ("time_ns, period_s", "time"), ("class Push", "class Pull")],
)
def test_a_law_runs_on_untouched_when_its_edited_file_is_broken(pushing: Bench, old: str, new: str) -> None:
    before = pushing.robot.manager.get("my_law")
    pushing.write(old, new)
    with pytest.raises(SlidectlError, match="my_laws"):
        pushing.reload()
    assert pushing.robot.manager.get("my_law") is before
    assert pushing.effort() == 2.0


def test_the_former_class_runs_when_the_edited_one_refuses_to_be_loaded(pushing: Bench) -> None:
    pushing.write("self.push = ", "self.push = 1 / 0 + ")
    reasons: list[str] = []
    with pushing.simulation.graph.log.answering(reasons):
        assert not pushing.reload()
    assert "the former class is loaded again" in reasons[0]
    assert pushing.effort() == 2.0


def test_a_law_that_raises_is_aborted_and_runs_again_when_it_is_mended(pushing: Bench) -> None:
    pushing.write("= self.push\n", "= self.push / 0\n")
    assert pushing.reload()
    pushing.simulation.step(2)
    assert pushing.states() == {"my_law": "aborted"}
    pushing.write()
    assert pushing.reload()
    assert pushing.effort() == 2.0


@pytest.mark.parametrize(
    ("command", "engine"),
    [
        *((command, "plain") for command in ("'x'", "None", "[1]", "10**400", "float('nan')")),
        pytest.param("'x'", "compiled", marks=pytest.mark.skipif(not is_possible(), reason="numba is not installed")),
    ],
)
def test_a_law_that_commands_no_number_is_aborted_and_the_last_command_stays(
    bench: Bench, command: str, engine: str
) -> None:
    bench.simulation = Simulation(engine=engine)
    bench.robot = bench.simulation.spawn(cart(), "cart")
    if engine == "compiled":
        bench.simulation.engine.complete()
    bench.write("= self.push\n", f"= self.push if time_ns < 20_000_000 else {command}\n")
    assert bench.load()
    assert switch(bench.simulation, start=["my_law"])
    lines = logged(bench.simulation)
    bench.simulation.step(40)
    assert bench.states() == {"my_law": "aborted"}
    [(_, line)] = lines
    assert "controller 'my_law' failed in update and is aborted: it set the command of joint 'joint1' to " in line
    assert f"which is not a finite number ({bench.file})" in line
    assert bench.simulation.world.joint_state("cart", "joint1")[2] == 1.0


ODD = """
class NoText(Exception):
    def __str__(self): raise ValueError("no text")

class NoTextNorEnd(Exception):
    def __str__(self): raise SystemExit(3)

class NoName(type):
    @property
    def __name__(cls): raise ValueError("no name")
    @property
    def __module__(cls): raise ValueError("no module")

class Nameless(Exception, metaclass=NoName):
    pass

class Untraced(Exception):
    __traceback__ = property(lambda self: 1 / 0)
    __cause__ = property(lambda self: 1 / 0)
    __class__ = property(lambda self: 1 / 0)

class OwnText(str):
    def replace(self, *_): raise ValueError("no such text")
    def __format__(self, _): raise ValueError("no such text")

class Told(Exception):
    def __str__(self): return OwnText("told")

from slidectl.errors import SlidectlError

class Mine(SlidectlError):
    def __init__(self): pass
    def __str__(self): raise ValueError("no text")

class Odd:
    def __repr__(self): raise SystemExit(5)
    def __float__(self): raise SystemExit(5)
    def __lt__(self, other): raise SystemExit(5)
    def __add__(self, other): return 0.0

def deep(): deep()

"""
"""The text in front of the law: classes of exceptions and values whose own methods fail."""
ODD_FAULTS = [
    ("raise NoText", "NoText: (no text: its __str__ raised ValueError)"),
    ("raise NoTextNorEnd", "NoTextNorEnd: (no text: its __str__ raised SystemExit)"),
    ("raise Nameless('why')", "Nameless: why"),
    ("raise Untraced('why')", "Untraced: why"),
    ("raise Told", "Told: told"),
    ("raise Mine", "Mine: (no text: its __str__ raised ValueError)"),
    ("raise KeyboardInterrupt", "KeyboardInterrupt: "),
    ("raise GeneratorExit", "GeneratorExit: "),
    ("raise SystemExit(3)", "SystemExit: 3"),
    ("raise __import__('asyncio').CancelledError", "CancelledError: "),
    ("__import__('pytest').fail('why')", "Failed: why"),
    ("raise MemoryError", "MemoryError: "),
    ("raise BaseExceptionGroup('both', [SystemExit(1), NoText()])", "BaseExceptionGroup: both"),
    ("deep()", "RecursionError: maximum recursion depth exceeded"),
    ("del self.joint.command", "it set the command of joint 'joint1' to None"),
    ("del self.joint.position", "it set the position of joint 'joint1' to None"),
    ("self.joint.velocity = 'x'", "it set the velocity of joint 'joint1' to 'x', which is not a finite number"),
    ("self.joint.effort = None", "it set the effort of joint 'joint1' to None"),
    ("self.joint.position = [1.0]", "it set the position of joint 'joint1' to [1.0]"),
    ("self.joint.position = 10**400", "it set the position of joint 'joint1' to 1000"),
    ("self.joint.position = 10**9999", "it set the position of joint 'joint1' to an object of class int"),
    ("self.joint.position = float('nan')", "it set the position of joint 'joint1' to nan"),
    ("self.joint.velocity = __import__('numpy').ones(3)", "it set the velocity of joint 'joint1' to array([1., 1."),
    ("self.joint.velocity = Odd()", "it set the velocity of joint 'joint1' to an object of class Odd"),
    ("self.joint.command = object()", "it set the command of joint 'joint1' to <object"),
    ("self.joint.command = Odd()", "it set the command of joint 'joint1' to an object of class Odd"),
]
"""Statements, and the error text of each."""
ENGINES = [
    "plain",
    pytest.param("compiled", marks=pytest.mark.skipif(not is_possible(), reason="numba is not installed")),
]


@pytest.fixture(params=ENGINES)
def shared(bench: Bench, request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Bench:
    """A robot of two joints whose other controllers run, and a second robot. A Ctrl-C would not end the process."""
    monkeypatch.setattr(user_classes, "_RAISES_INTERRUPT", object())
    bench.simulation = Simulation(engine=request.param)
    if request.param == "compiled":
        bench.simulation.engine.complete()
    bench.robot = bench.simulation.spawn(cart(joints=2), "cart")
    names = configure(bench.simulation, joints=2)
    for name in ("states", "position2"):
        assert bench.simulation.call("/cart/controller_manager/load_controller", {"name": name})["ok"]
    assert names[1] == "position1"
    bench.simulation.spawn(cart(), "other")
    drive_up(bench.simulation, "/other")
    return bench


def the_others_go_on(bench: Bench) -> None:
    for topic in ("/cart/position2/command", "/other/position1/command"):
        command(bench.simulation, 0.5, topic)
    heard: list[Any] = []
    subscription = bench.simulation.subscribe("/cart/joint_states", heard.append)
    bench.simulation.step(3000)
    subscription.close()
    assert heard
    assert state(bench.simulation, "cart", "joint2")[0] == pytest.approx(0.5, abs=0.1)
    assert state(bench.simulation, "other")[0] == pytest.approx(0.5, abs=0.1)
    assert states_of(bench.simulation, "/other") == {"states": "running", "position1": "running"}


@pytest.mark.parametrize(("fault", "said"), ODD_FAULTS, ids=[fault for fault, _ in ODD_FAULTS])
def test_a_law_that_does_something_odd_is_aborted_alone(shared: Bench, fault: str, said: str) -> None:
    wrong = f"        if time_ns > 20_000_000:\n            {fault}\n"
    shared.file.write_text(ODD + LAW + wrong, encoding="utf-8")
    assert shared.load()
    assert switch(shared.simulation, start=["my_law", "states", "position2"])
    lines = logged(shared.simulation)
    assert shared.simulation.step(40) == 40
    assert shared.states() == {"my_law": "aborted", "states": "running", "position2": "running"}
    [(severity, line)] = lines
    assert severity == "fatal"
    assert f"controller 'my_law' failed in update and is aborted: {said}" in line
    the_others_go_on(shared)
    shared.file.write_text(LAW, encoding="utf-8")
    assert shared.reload()
    assert shared.effort() == 1.0


@pytest.mark.parametrize("fault", ["raise NoText", "del self.joint.command", "self.joint.velocity = 'x'"])
@pytest.mark.parametrize("hook", ["init", "starting", "stopping", "aborting", "hear", "tick", "serve", "note"])
def test_every_hook_may_do_something_odd(shared: Bench, hook: str, fault: str) -> None:
    asked = """
        node.subscribe("hear", "std_msgs/String", self.hear)
        node.call_every(10_000_000, self.tick)
        node.advertise_service("serve", "std_srvs/Trigger", self.serve)
        node.set_param("noted", 1)
        node.watch_param("noted", self.note)
        self.told ="""
    methods = "".join(
        f"\n    def {name}(self, *_):\n        {fault if name == hook else 'pass'}\n"
        for name in ("starting", "stopping", "aborting", "hear", "tick", "serve", "note")
    )
    text = LAW.replace("\n        self.told =", asked) + methods
    if hook == "init":
        text = text.replace("self.push = params", f"{fault}\n        self.push = params")
    if hook == "aborting":
        text = text.replace("self.joint.command = self.push", "1 / 0")
    shared.file.write_text(ODD + text, encoding="utf-8")
    assert shared.load() is (hook != "init")
    others = ["states", "position2"]
    if hook == "init":
        assert switch(shared.simulation, start=others)
        the_others_go_on(shared)
        return
    assert switch(shared.simulation, start=["my_law", *others])
    shared.simulation.step(20)
    if hook == "hear":
        with pytest.raises(SlidectlError, match=r"NoText|it set"):
            shared.simulation.publish("/cart/my_law/hear", {"data": "x"})
    if hook == "serve":
        with pytest.raises(SlidectlError, match=r"NoText|it set"):
            shared.simulation.call("/cart/my_law/serve")
    if hook == "note":
        with suppress(SlidectlError):
            shared.simulation.parameters.set("/cart/my_law/noted", 2)
    if hook == "stopping":
        assert switch(shared.simulation, stop=["my_law"])
    shared.simulation.step(20)
    is_aborted = hook in ("starting", "stopping", "aborting")
    assert shared.states()["my_law"] == ("aborted" if is_aborted else "running")
    the_others_go_on(shared)


def test_numbers_of_numpy_are_commands(bench: Bench) -> None:
    bench.write("= self.push\n", "= __import__('numpy').float32(self.push)\n")
    assert bench.load()
    assert switch(bench.simulation, start=["my_law"])
    assert bench.effort() == 1.0


def test_a_callback_that_commands_no_number_is_told_and_changes_nothing(bench: Bench) -> None:
    hear = 'node.subscribe("hear", "std_msgs/String", lambda m: setattr(self.joint, "command", m["data"]))'
    bench.write("self.told =", f"{hear}\n        self.told =")
    assert bench.load()
    with pytest.raises(SlidectlError, match="it set the command of joint 'joint1' to 'x'"):
        bench.simulation.publish("/cart/my_law/hear", {"data": "x"})
    assert bench.simulation.step(3) == 3


def test_a_tick_or_a_call_that_raises_is_told_with_its_line_and_the_law_runs_on(bench: Bench) -> None:
    failing = """
        node.call_every(10_000_000, lambda: 1 / 0)
        node.advertise_service("ask", "std_srvs/Trigger", lambda request: {}["gain"])
        self.told ="""
    bench.write("\n        self.told =", failing)
    assert bench.load()
    assert switch(bench.simulation, start=["my_law"])
    lines = logged(bench.simulation)
    bench.simulation.step(25)
    told = ("error", f"/cart/my_law: ZeroDivisionError: division by zero ({bench.file}:15)")
    assert lines == [told, told]
    with pytest.raises(SlidectlError, match=r"KeyError: 'gain' \(.*my_laws.py:16\)"):
        bench.simulation.call("/cart/my_law/ask")
    assert bench.effort() == 1.0


def test_a_controller_of_slidectl_is_not_reloaded(bench: Bench) -> None:
    bench.simulation.parameters.set("/cart/my_law", {"type": STATES, "publish_rate": 50})
    bench.simulation.call("/cart/controller_manager/load_controller", {"name": "my_law"})
    with pytest.raises(SlidectlError, match="only those of users are reloaded"):
        bench.reload()


def test_a_simulation_imports_modules_by_file(bench: Bench) -> None:
    simulation = Simulation(imports=[str(bench.file)])
    robot = simulation.spawn(cart(), "cart")
    assert "my_laws/Push" in robot.manager.types()


# -- the cart-pole of the examples -------------------------------------------------------------------------------------


def test_the_regulator_of_the_example_balances_the_pole_with_the_gains_that_scipy_finds() -> None:
    from scipy.linalg import solve_continuous_are  # heavy

    simulation = Simulation(imports=[str(Path(__file__).parents[2] / "examples" / "cartpole.py")])
    robot = simulation.spawn(description.load("cartpole").xml, "cartpole")
    for name, value in {"type": "cartpole/Lqr", "weights": [10.0, 10.0, 1.0, 1.0]}.items():
        simulation.parameters.set(f"/cartpole/lqr/{name}", value)
    assert simulation.call("/cartpole/controller_manager/load_controller", {"name": "lqr"})["ok"]
    assert switch(simulation, start=["lqr"], namespace="/cartpole")
    example: Any = robot.manager.get("lqr")
    a, b = type(example).init.__globals__["linearised"](1.0, 0.2, 1.0, 0.5, 0.01)
    p = solve_continuous_are(a, b[:, None], np.diag([10.0, 10.0, 1.0, 1.0]), [[0.1]])
    assert np.allclose(example.gains, b @ p / 0.1, rtol=1e-9)
    moved = {"model_name": "cartpole", "joint_names": ["pole_joint"], "joint_positions": [0.2]}
    assert simulation.call("/gazebo/set_model_configuration", moved)["success"]
    farthest = 0.0
    for _ in range(1000):
        simulation.step(10)
        farthest = max(farthest, abs(example.cart.position))
    assert 0.1 < farthest < 1.0
    assert abs(example.cart.position) < 1e-2
    assert abs(example.pole.position) < 1e-4
