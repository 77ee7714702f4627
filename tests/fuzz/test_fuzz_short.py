"""A short part of the fuzz suite with a fixed seed; `make fuzz` tries more, with another seed each time."""

from __future__ import annotations

import pytest
from fuzz import run

CASES = {
    "lines": 80, "files": 60, "robots": 30, "meshes": 15, "manager": 3, "journals": 60, "times": 3, "snapshots": 30,
    "trajectories": 30, "textures": 10, "bombs": 6,
}  # fmt: skip


@pytest.mark.parametrize("kind", CASES)
def test_attacks_end_in_answers(kind: str) -> None:
    tally = run([kind], 1, 0, lambda _: lambda done: done < CASES[kind])
    assert not tally.faults, tally.text()
    assert sum(tally.counts.values()) == CASES[kind], tally.text()
