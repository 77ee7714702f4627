"""`make fuzz`: attacks on a daemon and on the readers of files, seeded, with what was tried and what came of it.

python tests/fuzz/fuzz.py [--seed N] [--seconds S | --count N] [--only KIND ...] [--first CASE]

Every case depends on the seed, its kind and its number alone: a fault names the command line that repeats it.
"""

from __future__ import annotations

import argparse
import os
import shutil
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parent.parent))
sys.path.insert(0, str(Path(__file__).parent.parent.parent))

from fuzz_attacks import ATTACKS as ATTACKS_ON_DAEMON
from fuzz_bombs import Bombs
from fuzz_frames import Frames
from fuzz_target import Tally, case_random, target
from fuzz_times import Times

ATTACKS = {**ATTACKS_ON_DAEMON, Frames.kind: Frames, Times.kind: Times, Bombs.kind: Bombs}
SHARES = {
    "lines": 0.08, "files": 0.12, "journals": 0.08, "robots": 0.1, "times": 0.05, "meshes": 0.08, "snapshots": 0.08,
    "trajectories": 0.08, "textures": 0.05, "manager": 0.06, "tcpros": 0.04, "xmlrpc": 0.04, "frames": 0.04,
    "foxglove": 0.03, "patterns": 0.03, "bombs": 0.04,
}  # fmt: skip
"""Of the seconds, by kind."""
_MOST_FAULTS = 5


def run(kinds: Sequence[str], seed: int, first: int, left: Callable[[str], Callable[[int], bool]]) -> Tally:
    """Try the kinds one after the other. `left(kind)(done)` says whether another case is to be tried."""
    tally = Tally()
    for kind in kinds:
        more, case = left(kind), first
        while more(case - first) and len(tally.faults) < _MOST_FAULTS:
            case = _attack(kind, seed, case, first, more, tally)
    return tally


def _attack(kind: str, seed: int, case: int, first: int, more: Callable[[int], bool], tally: Tally) -> int:
    """Cases on one daemon until a fault or the end; the number of the next case."""
    with target() as world:
        attack = ATTACKS[kind](world)
        while more(case - first):
            began = time.monotonic()
            outcome, problem = _try(attack, seed, kind, case)
            tally.count(kind, outcome, case, time.monotonic() - began)
            case += 1
            if problem:
                repeat = f"--seed {seed} --only {kind} --first {case - 1} --count 1"
                tally.faults.append(f"{kind}, case {case - 1} ({repeat}): {problem}")
                break
    return case


def _try(attack: Any, seed: int, kind: str, case: int) -> tuple[str, str]:
    """The outcome, and the fault if it is one."""
    try:
        return attack.case(case_random(seed, kind, case)), ""
    except Exception as error:
        return "FAULT", f"{type(error).__name__}: {error}"


def main(argv: Sequence[str]) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=None, help="of all cases; by default another one each time")
    parser.add_argument("--seconds", type=float, default=150.0, help="in all (150)")
    parser.add_argument("--count", type=int, help="cases of each kind, instead of seconds")
    parser.add_argument("--only", nargs="+", choices=list(ATTACKS), default=list(ATTACKS), help="kinds of attacks")
    parser.add_argument("--first", type=int, default=0, help="number of the first case")
    given = parser.parse_args(argv)
    seed = int.from_bytes(os.urandom(4), "big") if given.seed is None else given.seed
    whole = sum(SHARES[kind] for kind in given.only)
    print(f"seed {seed}", flush=True)

    def left(kind: str) -> Callable[[int], bool]:
        if given.count is not None:
            return lambda done: done < given.count
        end = time.monotonic() + given.seconds * SHARES[kind] / whole
        return lambda _: time.monotonic() < end

    folder = tempfile.mkdtemp(prefix="slidectl-fuzz-")
    os.environ["XDG_CACHE_HOME"] = tempfile.tempdir = folder
    try:
        tally = run(given.only, seed, given.first, left)
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    print(tally.text())
    return 1 if tally.faults else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
