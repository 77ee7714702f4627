"""LLVM code that numba cannot express: mj_step with its fatal errors caught, and the entries to cycle and laws.

MuJoCo ends the process on an error unless a hook leaves the step by `longjmp`. The hook is set during the step only.
The only Python here generates text.
"""

from collections.abc import Sequence

CYCLE = "slidectl_cycle"
"""The function from numba. Arguments: address of the result, address of the exception (it raises none), tables."""
STEP = "slidectl_physics_step"
UPDATE = "slidectl_update"
"""Calls the law of the controller whose row is at an address."""
GET, SET = "slidectl_get", "slidectl_set"
"""Read and write an element of the array that a MuJoCo variable points to; the array moves from step to step."""
ERROR_TEXT = "slidectl_error_text"
ENTRY = "slidectl_run"
"""The cycle with one argument: the address of the addresses of its tables. Returns the cycle's result."""

CODE = """
@place = internal global [128 x i64] zeroinitializer, align 16
@text = internal global [256 x i8] zeroinitializer

declare i32 @_setjmp(ptr) #0
declare void @longjmp(ptr, i32) #1
declare ptr @strncpy(ptr, ptr, i64)

define internal void @leave(ptr %said) #1 {
  call ptr @strncpy(ptr @text, ptr %said, i64 255)
  call void @longjmp(ptr @place, i32 1)
  unreachable
}

define ptr @slidectl_error_text() {
  ret ptr @text
}

define i64 @slidectl_physics_step(i64 %step, i64 %model, i64 %data, i64 %error_hook) #2 {
  %hook = inttoptr i64 %error_hook to ptr
  %hooked = icmp ne i64 %error_hook, 0
  br i1 %hooked, label %guarded, label %bare
guarded:
  %code = call i32 @_setjmp(ptr @place) #0
  %failed = icmp ne i32 %code, 0
  br i1 %failed, label %lost, label %try
try:
  store volatile ptr @leave, ptr %hook
  %guarded_step = inttoptr i64 %step to ptr
  call void %guarded_step(i64 %model, i64 %data)
  store volatile ptr null, ptr %hook
  ret i64 0
lost:
  store volatile ptr null, ptr %hook
  ret i64 1
bare:
  %bare_step = inttoptr i64 %step to ptr
  call void %bare_step(i64 %model, i64 %data)
  ret i64 0
}

define i64 @slidectl_update(i64 %controller, i64 %joints, i64 %pids, i64 %time, double %period) {
  %place = inttoptr i64 %controller to ptr
  %law = load ptr, ptr %place
  %joints_ = inttoptr i64 %joints to ptr
  %pids_ = inttoptr i64 %pids to ptr
  %turn = call i64 %law(ptr %place, ptr %joints_, ptr %pids_, i64 %time, double %period)
  ret i64 %turn
}

define double @slidectl_get(i64 %variable, i64 %index) {
  %place = inttoptr i64 %variable to ptr
  %array = load ptr, ptr %place
  %element = getelementptr double, ptr %array, i64 %index
  %value = load double, ptr %element
  ret double %value
}

define void @slidectl_set(i64 %variable, i64 %index, double %value) {
  %place = inttoptr i64 %variable to ptr
  %array = load ptr, ptr %place
  %element = getelementptr double, ptr %array, i64 %index
  store double %value, ptr %element
  ret void
}

attributes #0 = { returns_twice nounwind }
attributes #1 = { noreturn }
attributes #2 = { noinline }
"""


def law(number: int) -> str:
    """The name of the entry to the law of one of our forms."""
    return f"slidectl_law{number}"


def entry(tables: int) -> str:
    """Code of the entry for this number of tables."""
    loads = "".join(
        f"  %place{k} = getelementptr ptr, ptr %tables, i64 {k}\n  %table{k} = load ptr, ptr %place{k}\n"
        for k in range(tables)
    )
    arguments = "".join(f", ptr %table{k}" for k in range(tables))
    return f"""
declare i32 @{CYCLE}(ptr, ptr{", ptr" * tables})

define i64 @{ENTRY}(ptr %tables) {{
  %result = alloca i64
{loads}  %status = call i32 @{CYCLE}(ptr %result, ptr null{arguments})
  %turn = load i64, ptr %result
  ret i64 %turn
}}
"""


def law_entry(law: str, columns: Sequence[str], raised: int) -> str:
    """Code of the entry `law`, for a controller's row with these columns: it calls numba's function, named `law` plus
    `_body`. An exception makes it return `raised`."""
    loads = "".join(
        f"  %{name}_ = getelementptr i64, ptr %controller, i64 {k}\n  %{name} = load {kind}, ptr %{name}_\n"
        for k, name in enumerate(columns)
        for kind in ["i64" if name in ("count", "size") else "ptr"]
    )
    return f"""
declare i32 @{law}_body(ptr, ptr, ptr, ptr, i64, ptr, ptr, ptr, i64, i64, double)

define i64 @{law}(ptr %controller, ptr %joints, ptr %pids, i64 %time, double %period) {{
  %result = alloca i64
  %exception = alloca ptr
{loads}  %status = call i32 @{law}_body(ptr %result, ptr %exception, ptr %row, ptr %members, i64 %count, ptr %joints,
                                ptr %pids, ptr %numbers, i64 %size, i64 %time, double %period)
  %good = icmp eq i32 %status, 0
  %returned = load i64, ptr %result
  %turn = select i1 %good, i64 %returned, i64 {raised}
  ret i64 %turn
}}
"""
