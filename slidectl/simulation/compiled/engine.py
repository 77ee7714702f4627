"""Chooses the engine that runs the cycles: the interpreter, or machine code when it is ready.

Compiling happens in a process of its own and once for all simulations; loading the result takes some 50 ms.
The interpreter runs the cycles until then.
"""

from __future__ import annotations

import signal
import subprocess
from typing import TYPE_CHECKING

from slidectl.errors import Refused, UsageError
from slidectl.paths import install_command
from slidectl.simulation.compiled import object_file
from slidectl.simulation.graph import WORLD_NODE

if TYPE_CHECKING:
    from slidectl.simulation.compiled.runner import CompiledRunner
    from slidectl.simulation.loop import Loop

ENGINES = ("plain", "compiled", "auto")
WORTH_COMPILING = 10_000
"""The number of cycles in one `step` from which on a simulation without a driver starts to compile."""


class Engine:
    """`chosen` is one of ENGINES. `compiled` runs the cycles as machine code; None while the interpreter runs all."""

    def __init__(self, loop: Loop, chosen: str) -> None:
        """Raises UsageError: no such engine. Refused: `compiled` without numba."""
        if chosen not in ENGINES:
            raise UsageError(f"there is no engine {chosen!r}", f"choose one of: {', '.join(ENGINES)}")
        if chosen == "compiled":
            _check_possible()
        self._loop = loop
        self._chosen = chosen
        self._compiling: subprocess.Popen[bytes] | None = None
        self._trouble = ""
        self._has_looked = False
        self.compiled: CompiledRunner | None = None
        self.may_load = True
        """False while a driver has more urgent work than to wait for code to be loaded."""
        self.is_settled = chosen == "plain" or not object_file.is_possible()
        """True when the engine will not change any more."""

    def __str__(self) -> str:
        if self.compiled is not None:
            return "compiled"
        if self._trouble:
            return f"plain: {self._trouble}"
        if self.is_settled:
            return "plain"
        return f"{self._chosen}: {'plain so far' if self._compiling is None else 'compiling, plain meanwhile'}"

    def advance(self, cycles: int) -> None:
        """Called before `cycles` cycles: load the code if it exists, else start the compiler if that is worthwhile."""
        is_worth_it = self._loop.driven or cycles >= WORTH_COMPILING
        ended = None if self._compiling is None else self._compiling.poll()
        # A script that runs a few cycles looks for the code once: each look takes microseconds.
        has_reason = (is_worth_it or not self._has_looked) if self._compiling is None else ended is not None
        if not self.may_load or not has_reason:
            return
        self._has_looked = True
        if object_file.is_there():
            self._load()
        elif ended is not None:
            self._give_up(_what_failed(ended))
        elif is_worth_it:
            try:
                self._compiling = _begin_to_compile()
            except Refused as refusal:
                self._give_up(refusal.message)

    def complete(self) -> None:
        """Compile, if needed, and load, in this call, including the laws of users' running controllers. Raises Refused
        when that fails."""
        _check_possible()
        self._trouble = ""
        while self.compiled is None:
            if not object_file.is_there():
                code = _begin_to_compile().wait()
                if not object_file.is_there():
                    raise Refused(_what_failed(code))
            self._load()
            if self._trouble:
                raise Refused(self._trouble)
        self.compiled.load_laws(wait=True)

    def _load(self) -> None:
        from slidectl.simulation.compiled.runner import CompiledRunner

        try:
            code = object_file.load()
        except FileNotFoundError:  # another version's compiler has just removed it
            self._compiling = None
            return
        except (OSError, RuntimeError, ImportError) as error:
            self._give_up(f"the compiled code cannot be loaded: {error}")
            return
        self.is_settled = True
        self._loop.runner = self.compiled = CompiledRunner(self._loop, code)
        self._loop.set_robots(self._loop.robots)

    def _give_up(self, trouble: str) -> None:
        self.is_settled = True
        self._trouble = trouble
        level = "error" if self._chosen == "compiled" else "warn"
        self._loop.graph.log(level, WORLD_NODE, f"cycles run in the interpreter: {trouble}")


def _check_possible() -> None:
    if not object_file.is_possible():
        raise Refused("the compiled engine needs numba", f"install it: {install_command('fast')}")


def _what_failed(code: int) -> str:
    if code < 0:
        return f"the compiler was ended by {signal.Signals(-code).name}"
    return f"compiling failed, see {object_file.report()}"


def _begin_to_compile() -> subprocess.Popen[bytes]:
    """Start the compiler. Raises Refused: the result cannot be stored."""
    try:
        object_file.prepare()
        with object_file.report().open("a", encoding="utf-8") as report:
            return object_file.start_compiler(source=subprocess.DEVNULL, report=report)
    except OSError as error:
        raise Refused(f"there is no place for compiled code: {error}") from error
