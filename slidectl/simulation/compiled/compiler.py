"""Compiles the cycle to machine code: numba compiles it, LLVM writes an object file. Runs in a process of its own.

`python -m slidectl.simulation.compiled.compiler` writes the object file of the cycle into its folder, which must exist.
With a file name as argument it writes the object file of the law described on its standard input.
numba is imported in this module only.
No fast-math and no fused operations, so that the code computes the same bits as the interpreter.
"""

from __future__ import annotations

import ctypes
import fcntl
import math
import os
import sys
import traceback
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import llvmlite.binding as llvm
import numba
import numpy as np
from numba.extending import overload, register_jitable

from slidectl.control.laws import LAWS, Columns, LawTables
from slidectl.control.pid import Pid
from slidectl.control.registry import compiled_forms
from slidectl.errors import Refused
from slidectl.simulation.compiled import guard, kernel, object_file, own_laws
from slidectl.simulation.compiled.object_file import machine
from slidectl.simulation.compiled.tables import CONTROLLER, JOINT, RAISED, TABLES, Progress

types: Any = numba.types
carray: Any = numba.carray  # type: ignore[attr-defined]

_NICENESS = 10
"""The niceness of the compiler, so that running simulations have priority."""
_MOST_LINES = 6
"""The most lines of numba's error about a law."""
_ROOM = 1 << 30
"""The declared number of rows of a table; no memory is allocated for them."""


def column_type(columns: Columns) -> Any:
    """The rows as a numpy type."""
    return record_type(columns.names, columns.kinds)


def record_type(names: Sequence[str], kinds: str) -> Any:
    """Columns of whole numbers (`q`) and floats as a numpy type."""
    formats = [("i8" if kind == "q" else "f8") for kind in kinds]
    return np.dtype(list(zip(names, formats, strict=True)))


def register_laws() -> None:
    """Let compiled functions call the laws, and the functions of `math` that numba lacks."""
    fmod_of_c = types.ExternalFunction("fmod", types.float64(types.float64, types.float64))

    @overload(math.fmod, strict=False)
    def _fmod(x: Any, y: Any) -> Any:  # noqa: ARG001
        return lambda x, y: fmod_of_c(x, y)

    for law in LAWS:
        register_jitable(law)


def compile_cycle() -> bytes:
    """The object file of the cycle."""
    forms = list(enumerate(compiled_forms().values()))  # imports all controllers and their laws
    register_laws()
    step = types.ExternalFunction(guard.STEP, types.int64(*4 * [types.int64]))

    @overload(kernel.physics_step, strict=False)
    def _physics_step(step_: Any, model: Any, data: Any, error_hook: Any) -> Any:  # noqa: ARG001
        return lambda step_, model, data, error_hook: step(step_, model, data, error_hook)

    update = types.ExternalFunction(guard.UPDATE, types.int64(*4 * [types.int64], types.float64))

    @overload(kernel.update_controller, strict=False)
    def _update_controller(controller: Any, joints: Any, pids: Any, time_ns: Any, period_s: Any) -> Any:  # noqa: ARG001
        return lambda controller, joints, pids, time_ns, period_s: update(controller, joints, pids, time_ns, period_s)

    get = types.ExternalFunction(guard.GET, types.float64(types.int64, types.int64))
    set_ = types.ExternalFunction(guard.SET, types.void(types.int64, types.int64, types.float64))

    @overload(kernel.element, strict=False)
    def _element(variable: Any, index: Any) -> Any:  # noqa: ARG001
        return lambda variable, index: get(variable, index)

    @overload(kernel.set_element, strict=False)
    def _set_element(variable: Any, index: Any, value: Any) -> Any:  # noqa: ARG001
        return lambda variable, index, value: set_(variable, index, value)

    # numba links compiled code at once, though it is never called in this process.
    for name in (guard.STEP, guard.UPDATE, guard.GET, guard.SET):
        llvm.add_symbol(name, ctypes.cast(ctypes.CDLL(None).abort, ctypes.c_void_p).value)
    code = [
        _made_of(types.int64(*_arguments()), _on_pointers(), guard.CYCLE),
        *(
            law_code(form.update, column_type(form.row), column_type(form.members), guard.law(number))
            for number, form in forms
        ),
    ]
    laws = [guard.law(number) for number, _ in forms]
    entries = [guard.entry(len(_arguments())), *(guard.law_entry(law, CONTROLLER.names, RAISED) for law in laws)]
    return _object_file([*code, guard.CODE, *entries], {guard.ENTRY, guard.ERROR_TEXT, *laws})


def compile_law(content: bytes) -> bytes:
    """The object file of a user's law, from its description; with index checks. Raises as `_object_file`."""
    columns, law, functions = own_laws.rebuild(content)
    compiled_forms()
    register_laws()
    for function in functions:
        register_jitable(boundscheck=True)(function)
    row, member = (record_type(names, kinds) for names, kinds in columns)
    name = guard.law(0)
    code = [law_code(law, row, member, name, boundscheck=True), guard.law_entry(name, CONTROLLER.names, RAISED)]
    return _object_file(code, {name})


def law_code(law: Callable[..., int], row_type: Any, member_type: Any, name: str, **options: Any) -> str:
    """LLVM code of the law of a controller with such rows, for `guard.law_entry`."""
    row, member, joint, pid = (
        types.CPointer(numba.from_dtype(record))
        for record in (row_type, member_type, column_type(JOINT), column_type(Pid.columns))
    )

    def body(
        row: Any, members: Any, count: Any, joints: Any, pids: Any, numbers: Any, size: Any, time_ns: Any, period_s: Any
    ) -> Any:
        tables = LawTables(carray(joints, _ROOM), carray(pids, _ROOM), carray(members, count), carray(numbers, size))
        return law(carray(row, 1)[0], tables, time_ns, period_s)

    double = types.CPointer(types.float64)
    signature = types.int64(row, member, types.int64, joint, pid, double, types.int64, types.int64, types.float64)
    return _made_of(signature, body, f"{name}_body", **options)


def _made_of(signature: Any, function: Callable[..., Any], name: str, **options: Any) -> str:
    """LLVM code of the function under that name, without numba's own entry to it."""
    made = numba.cfunc(signature, **options)(function)
    module = llvm.parse_assembly(made.inspect_llvm())
    module.get_function(made.native_name.removeprefix("cfunc.")).name = name
    return str(module)


def _arguments() -> list[Any]:
    progress = np.dtype([(field[0], "i8") for field in Progress._fields_])
    records = [progress, *(column_type(columns) for columns in TABLES.values())]
    pointers = [types.CPointer(numba.from_dtype(record)) for record in records]
    return pointers + (len(kernel.CycleTables._fields) - len(TABLES)) * [types.CPointer(types.float64)]


def _on_pointers() -> Callable[..., int]:
    """`kernel.run` on addresses of tables. The source is generated: numba needs each argument written out."""
    names = kernel.CycleTables._fields
    tables = ", ".join(f"carray({name}, room)" for name in names)
    source = (
        f"def cycle(progress, {', '.join(names)}):\n    return run(carray(progress, 1)[0], CycleTables({tables}))\n"
    )
    space: dict[str, Any] = {
        "run": register_jitable(kernel.run),
        "CycleTables": kernel.CycleTables,
        "carray": carray,
        "room": _ROOM,
    }
    exec(source, space)
    cycle: Callable[..., int] = space["cycle"]
    return cycle


def _object_file(code: list[str], entries: set[str]) -> bytes:
    """The object file of all code in one module, in which only the entries can be called from outside.

    Raises Refused: it calls a function that needs numba.
    """
    target = machine()
    module = llvm.parse_assembly(code[0])
    for other in code[1:]:
        module.link_in(llvm.parse_assembly(other))
    for function in module.functions:
        if not function.is_declaration and function.name not in entries:
            function.linkage = "internal"
    for variable in module.global_variables:
        if not variable.is_declaration:
            variable.linkage = "internal"
    tuning = llvm.create_pipeline_tuning_options(speed_level=3)
    passes = llvm.create_pass_builder(target, tuning)
    passes.getModulePassManager().run(module, passes)
    for function in module.functions:
        is_known = function.name.startswith("llvm.") or hasattr(ctypes.CDLL(None), function.name)
        if function.is_declaration and not is_known:
            raise Refused(f"it makes objects ({function.name}), and a law works on numbers alone")
    made: bytes = target.emit_object(module)
    return made


def main() -> int:
    """Compile, and return the exit code. Concurrent runs wait for the first and use its result. Errors are in the
    report."""
    os.nice(_NICENESS)
    if len(sys.argv) > 1:
        return _compile_law(object_file.folder() / sys.argv[1])
    try:
        turn = object_file.report().open("a", encoding="utf-8")
    except OSError:  # the folder was removed, so the code is not needed any more
        return 1
    with turn:
        fcntl.flock(turn, fcntl.LOCK_EX)
        if object_file.is_there():
            return 0
        turn.truncate(0)
        try:
            object_file.write(object_file.place(), compile_cycle())
            object_file.tidy()
        except Exception:
            turn.write(traceback.format_exc())
            return 1
        return 0


def _compile_law(place: Path) -> int:
    """Compile the law described on the standard input. An error is printed on one line."""
    try:
        object_file.write(place, compile_law(sys.stdin.buffer.read()))
        object_file.tidy()
    except Exception as trouble:
        lines = [line.strip() for line in str(trouble).splitlines() if line.strip()]
        print(": ".join(lines[:_MOST_LINES]) or type(trouble).__name__, file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
