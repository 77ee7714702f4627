"""A hundred thousand inputs to each parser of what comes from a network: answers, and flat memory."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from fuzz import run
from fuzz_foxglove import FRAMES, READ
from fuzz_frames import FRAMES_A_CASE, READ_A_CASE
from fuzz_tcpros import STREAMS
from fuzz_xmlrpc import DOCUMENTS

INPUTS = 100_000
OF_A_CASE = {
    "tcpros": STREAMS,
    "xmlrpc": DOCUMENTS,
    "frames": FRAMES_A_CASE + READ_A_CASE,
    "foxglove": FRAMES + READ,
    "patterns": 100,
}
MOST_GROWTH = 16 << 20
"""Bytes by which the memory of this process may grow after the first quarter. The inputs together have more."""


def memory_bytes() -> int:
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")


@pytest.mark.timeout(1200)  # it computes all the time, and so takes as long as the machine is busy with others
@pytest.mark.parametrize("kind", OF_A_CASE)
def test_a_hundred_thousand_inputs_end_in_answers(kind: str) -> None:
    cases = -(-INPUTS // OF_A_CASE[kind])
    before = 0

    def is_left(done: int) -> bool:
        nonlocal before
        if done == cases // 4:
            before = memory_bytes()
        return done < cases

    tally = run([kind], 1, 0, lambda _: is_left)
    assert not tally.faults, tally.text()
    assert sum(tally.counts.values()) == cases, tally.text()
    assert memory_bytes() - before < MOST_GROWTH
