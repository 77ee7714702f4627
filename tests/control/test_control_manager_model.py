"""Random sequences of loads, switches, failures and unloads: the manager does what a small model of it does."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

from fake_robot import Bench, FakeRobot
from hypothesis import given
from hypothesis import strategies as st

CLAIMS = {"a": {"joint1"}, "b": {"joint1", "joint2"}, "c": {"joint3"}, "d": set(), "lost": {"joint9"}, "typeless": None}
"""What each configured controller claims. Two of them cannot be loaded."""
NAMES = st.sampled_from([*CLAIMS, "unknown"])
LISTS = st.lists(NAMES, max_size=3)
BEST_EFFORT, STRICT = 1, 2


@dataclass
class Model:
    """States in load order, and how often each hook was called since the load."""

    states: dict[str, str] = field(default_factory=dict)
    calls: dict[str, Counter[str]] = field(default_factory=dict)
    broken: set[str] = field(default_factory=set)
    """Those whose update raises."""

    def load(self, name: str) -> bool:
        if name in self.states or name in ("lost", "typeless", "unknown"):
            return False
        self.states[name], self.calls[name] = "initialized", Counter()
        return True

    def unload(self, name: str) -> bool:
        if self.states.get(name, "running") == "running":
            return False
        del self.states[name]
        self.broken.discard(name)
        return True

    def running(self) -> set[str]:
        return {name for name, state in self.states.items() if state == "running"}

    def switch(self, start: list[str], stop: list[str], strictness: int) -> bool:
        """Decided at once, carried out after the updates of the next cycle."""
        if strictness == STRICT and not {*start, *stop} <= self.states.keys():
            return False
        starts, stops = {*start} & self.states.keys(), {*stop} & self.states.keys()
        if strictness == STRICT and (stops - self.running() or starts & self.running() - stops):
            return False
        genuine_stops = stops & self.running()
        if starts & genuine_stops:
            return False
        after = self.running() - genuine_stops | starts
        joints = Counter(joint for name in after for joint in CLAIMS[name] or ())
        if any(count > 1 for count in joints.values()):
            return False
        self.update()
        for name in stop:
            if self.states.get(name) == "running":
                self.states[name] = "stopped"
                self.calls[name]["stopping"] += 1
        for name in start:  # also one that runs, in a best-effort request, and each as often as it is named
            if name in self.states:
                self.states[name] = "running"
                self.calls[name]["starting"] += 1
        return True

    def update(self) -> None:
        for name in self.running():
            self.calls[name]["aborting" if name in self.broken else "update"] += 1
            if name in self.broken:
                self.states[name] = "aborted"


OPERATIONS = st.one_of(
    st.tuples(st.just("load"), NAMES),
    st.tuples(st.just("unload"), NAMES),
    st.tuples(st.just("break"), NAMES),
    st.tuples(st.just("switch"), LISTS, LISTS, st.sampled_from([BEST_EFFORT, STRICT])),
    st.tuples(st.just("update")),
)


@given(st.lists(OPERATIONS, max_size=40))
def test_any_sequence_of_requests_leads_where_the_model_says(operations: list[tuple]) -> None:
    parameters = {name: {"joints": sorted(joints)} for name, joints in CLAIMS.items() if joints is not None}
    bench = Bench(FakeRobot(["joint1", "joint2", "joint3"]), {**parameters, "typeless": {"type": 5}})
    model = Model()
    for verb, *arguments in operations:
        if verb == "update":
            bench.run()
            model.update()
        elif verb == "break":
            if (controller := bench.manager.get(*arguments)) is not None:
                controller.update = lambda *_: 1 / 0
                model.broken.add(*arguments)
        elif verb == "switch":
            ok = bench.request(*arguments)
            assert ok == model.switch(*arguments)
            if ok:
                bench.run()
                assert bench.answers.pop()
        else:
            assert getattr(bench.manager, verb)(*arguments) == getattr(model, verb)(*arguments)
        assert list(bench.states().items()) == list(model.states.items())
        assert {name: Counter(bench.calls(name)) for name in model.states} == {
            name: model.calls[name] for name in model.states
        }
        assert [entry.name for entry in bench.manager.running] == [n for n in model.states if n in model.running()]
