"""Makes machine code of the cycle: numba compiles it, LLVM writes an object file. Runs in a process of its own.

`python -m slidectl.simulation.compiled.compiler` writes the file that is looked for, into a folder that is there.
Only here is numba imported.
No fast-math and no fused operations, so that the code computes the same bits as the interpreter.
"""

from __future__ import annotations

import ctypes
import fcntl
import math
import os
import sys
import traceback
from collections.abc import Callable
from typing import Any

import llvmlite.binding as llvm
import numba
import numpy as np
from numba.extending import overload, register_jitable

from slidectl.control.laws import LAWS, Columns
from slidectl.simulation.compiled import guard, kernel, object_file
from slidectl.simulation.compiled.object_file import machine
from slidectl.simulation.compiled.tables import ARRAYS, CYCLE_TABLES, FORMS, TABLES, Progress, form_table

types: Any = numba.types
carray: Any = numba.carray  # type: ignore[attr-defined]

_MODESTY = 10
"""How much the simulations that run meanwhile go first (nice)."""
_ROOM = 1 << 30
"""Rows that a table may have; no memory is taken for them."""


def column_type(columns: Columns) -> Any:
    """The rows as a numpy type."""
    formats = [("i8" if kind == "q" else "f8") for kind in columns.kinds]
    return np.dtype(list(zip(columns.names, formats, strict=True)))


def teach_laws() -> None:
    """Let compiled functions call the laws, and what of `math` numba does not know."""
    fmod_of_c = types.ExternalFunction("fmod", types.float64(types.float64, types.float64))

    @overload(math.fmod, strict=False)
    def _fmod(x: Any, y: Any) -> Any:  # noqa: ARG001
        return lambda x, y: fmod_of_c(x, y)

    for law in LAWS:
        register_jitable(law)


def compile_cycle() -> bytes:
    """The object file."""
    teach_laws()
    step = types.ExternalFunction(guard.STEP, types.int64(*4 * [types.int64]))

    @overload(kernel.physics_step, strict=False)
    def _physics_step(step_: Any, model: Any, data: Any, error_hook: Any) -> Any:  # noqa: ARG001
        return lambda step_, model, data, error_hook: step(step_, model, data, error_hook)

    @overload(kernel.update_controller, strict=False)
    def _update_controller(kind: Any, row: Any, tables: Any, time_ns: Any, period_s: Any) -> Any:  # noqa: ARG001
        return _dispatch()

    get = types.ExternalFunction(guard.GET, types.float64(types.int64, types.int64))
    put = types.ExternalFunction(guard.PUT, types.void(types.int64, types.int64, types.float64))

    @overload(kernel.element, strict=False)
    def _element(variable: Any, index: Any) -> Any:  # noqa: ARG001
        return lambda variable, index: get(variable, index)

    @overload(kernel.put_element, strict=False)
    def _put_element(variable: Any, index: Any, value: Any) -> Any:  # noqa: ARG001
        return lambda variable, index, value: put(variable, index, value)

    # numba links what it compiled at once, though it is never called here.
    for name in (guard.STEP, guard.GET, guard.PUT):
        llvm.add_symbol(name, ctypes.cast(ctypes.CDLL(None).abort, ctypes.c_void_p).value)
    function = numba.cfunc(types.int64(*_arguments()))(_on_pointers())
    return _object_file(function.inspect_llvm(), function.native_name.removeprefix("cfunc."))


def _dispatch() -> Callable[..., bool]:
    """`kernel.update_controller`: one branch for each registered form. numba wants the branches written out."""
    forms = tuple(FORMS.values())
    lines = [
        f"    if kind == {kind}:\n"
        f"        return law{kind}(tables.forms[{kind}][row], tables.joints, tables.pids, time_ns, period_s)\n"
        for kind in range(len(forms))
    ]
    source = f"def update_controller(kind, row, tables, time_ns, period_s):\n{''.join(lines)}    return False\n"
    return _made(source, "update_controller", {f"law{kind}": form.update for kind, form in enumerate(forms)})


def _arguments() -> list[Any]:
    progress = np.dtype([(field[0], "i8") for field in Progress._fields_])
    records = [progress, *(column_type(columns) for columns in TABLES.values())]
    pointers = [types.CPointer(numba.from_dtype(record)) for record in records]
    return pointers + len(ARRAYS) * [types.CPointer(types.float64)]


def _on_pointers() -> Callable[..., int]:
    """`kernel.run` on addresses of tables. One argument after the other: numba wants them written out."""
    names = ("progress", *TABLES, *ARRAYS)
    table = {name: f"carray({name}, room)" for name in names[1:]}
    cycle = ", ".join(table[name] for name in CYCLE_TABLES)
    forms = "".join(table[form_table(kind)] + ", " for kind in range(len(FORMS)))
    arrays = ", ".join(table[name] for name in ARRAYS)
    source = (
        f"def cycle({', '.join(names)}):\n"
        f"    return run(carray(progress, 1)[0], CycleTables({cycle}, ({forms}), {arrays}))\n"
    )
    space = {"run": register_jitable(kernel.run), "CycleTables": kernel.CycleTables, "carray": carray, "room": _ROOM}
    return _made(source, "cycle", space)


def _made(source: str, name: str, space: dict[str, Any]) -> Callable[..., Any]:
    """The function of that name that the source defines, which sees what is in `space`."""
    exec(source, space)
    function: Callable[..., Any] = space[name]
    return function


def _object_file(code: str, entry: str) -> bytes:
    """Code, guard and entry as one module in which only the entry can be called from outside."""
    target = machine()
    module = llvm.parse_assembly(code)
    module.get_function(entry).name = guard.CYCLE
    for other in (guard.CODE, guard.entry(len(_arguments()))):
        module.link_in(llvm.parse_assembly(other))
    for function in module.functions:
        if not function.is_declaration and function.name not in (guard.ENTRY, guard.ERROR_TEXT):
            function.linkage = "internal"
    for variable in module.global_variables:
        if not variable.is_declaration:
            variable.linkage = "internal"
    tuning = llvm.create_pipeline_tuning_options(speed_level=3)
    passes = llvm.create_pass_builder(target, tuning)
    passes.getModulePassManager().run(module, passes)
    made: bytes = target.emit_object(module)
    return made


def main() -> int:
    """Several of these at once wait for the first one and find its work done. What goes wrong is in the report."""
    os.nice(_MODESTY)
    try:
        turn = object_file.report().open("a", encoding="utf-8")
    except OSError:  # the folder has gone: whoever wanted the code has, too
        return 1
    with turn:
        fcntl.flock(turn, fcntl.LOCK_EX)
        if object_file.is_there():
            return 0
        turn.truncate(0)
        try:
            object_file.write(compile_cycle())
            object_file.tidy()
        except Exception:
            turn.write(traceback.format_exc())
            return 1
        return 0


if __name__ == "__main__":
    sys.exit(main())
