"""The loop, the signals and the children that a launch stands on."""

from __future__ import annotations

import os
import signal
import subprocess
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest

from slidectl.event_loop import READ
from slidectl.supervision import Child, Interrupted, Interrupts, Watch, run

DEADLINE_S = 30.0


def until(watch: Watch, condition: object) -> None:
    deadline = time.monotonic() + DEADLINE_S
    while not condition():  # type: ignore[operator]
        assert time.monotonic() < deadline
        watch.turn(1.0)


def test_timers_fire_in_the_order_of_their_times() -> None:
    watch = Watch()
    fired: list[str] = []
    watch.later(0.02, lambda: fired.append("second"))
    watch.later(0.0, lambda: fired.append("first"))
    until(watch, lambda: len(fired) == 2)
    assert fired == ["first", "second"]


def test_a_readable_descriptor_is_told_until_it_is_forgotten() -> None:
    watch = Watch()
    read, write = os.pipe()
    heard: list[bytes] = []
    watch.watch(read, READ, lambda _: heard.append(os.read(read, 1)))
    os.write(write, b"ab")
    until(watch, lambda: heard == [b"a", b"b"])
    os.write(write, b"c")
    watch.forget(read)
    watch.forget(read)
    watch.turn(0.0)
    assert heard == [b"a", b"b"]
    os.close(read)
    os.close(write)


def test_one_action_may_forget_what_another_waits_for() -> None:
    watch = Watch()
    ends = [os.pipe() for _ in range(2)]
    heard: list[int] = []

    def take(index: int) -> None:
        heard.append(index)
        for read, _ in ends:
            watch.forget(read)

    for index, (read, write) in enumerate(ends):
        watch.watch(read, READ, lambda _, index=index: take(index))  # type: ignore[misc]
        os.write(write, b"x")
    watch.turn(1.0)
    assert len(heard) == 1
    for end in (end for pair in ends for end in pair):
        os.close(end)


def interrupt() -> None:
    """Send this process a SIGINT; Python hears it before the next line."""
    os.kill(os.getpid(), signal.SIGINT)


def test_signals_are_only_noted_for_who_looks() -> None:
    with Interrupts() as interrupts:
        interrupt()
        interrupts.check()
        assert interrupts.received == [signal.SIGINT]
    with pytest.raises(KeyboardInterrupt):
        interrupt()


def test_the_first_signal_is_raised_at_once_where_it_is_asked_for_and_later_ones_are_only_noted() -> None:
    def interrupt_twice() -> None:
        try:
            interrupt()
        finally:
            interrupt()

    with Interrupts() as interrupts:
        with pytest.raises(Interrupted) as caught, interrupts.raised():
            interrupt_twice()
        assert caught.value.number == signal.SIGINT
        interrupt()
        assert interrupts.received == [signal.SIGINT] * 3


def test_a_signal_that_came_before_is_raised_at_the_beginning() -> None:
    with Interrupts() as interrupts:
        interrupt()
        with pytest.raises(Interrupted), interrupts.raised():
            pytest.fail("it is not raised")


def test_a_signal_that_comes_while_they_are_held_is_raised_at_the_end_of_the_outermost_block() -> None:
    done: list[str] = []

    def work(interrupts: Interrupts) -> None:
        with interrupts.raised():
            with interrupts.held():
                with interrupts.held():
                    interrupt()
                    done.append("inner")
                done.append("outer")
            done.append("never")

    with Interrupts() as interrupts:
        with pytest.raises(Interrupted):
            work(interrupts)
        assert done == ["inner", "outer"]


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_a_signal_that_was_lost_in_a_finalizer_is_raised_by_who_looks() -> None:
    class Finalized:
        def __del__(self) -> None:
            interrupt()

    with Interrupts() as interrupts, interrupts.raised():
        Finalized()
        assert interrupts.received == [signal.SIGINT]
        with pytest.raises(Interrupted):
            interrupts.check()
        interrupts.received.clear()


def child(watch: Watch, script: str) -> tuple[Child, list[tuple[str, str]], list[int]]:
    lines: list[tuple[str, str]] = []
    codes: list[int] = []
    started = Child(["bash", "-c", script], watch, lambda *line: lines.append(line), codes.append)
    return started, lines, codes


def test_a_child_tells_its_lines_and_its_end() -> None:
    watch = Watch()
    started, lines, codes = child(watch, r"printf 'a\nb'; printf '\xff\n' >&2; exit 5")
    until(watch, lambda: codes)
    assert codes == [5]
    assert sorted(lines) == [("stderr", "\ufffd"), ("stdout", "a"), ("stdout", "b")]
    started.release()


def test_a_line_without_an_end_is_told_in_pieces() -> None:
    watch = Watch()
    started, lines, codes = child(watch, "head -c 300000 /dev/zero | tr '\\0' x")
    until(watch, lambda: codes)
    assert sum(len(text) for _, text in lines) == 300000
    assert len(lines) > 1
    started.release()


def test_the_end_of_a_child_by_a_signal_is_a_negative_code() -> None:
    watch = Watch()
    started, _, codes = child(watch, "exec sleep 600")
    started.signal(signal.SIGTERM)
    until(watch, lambda: codes)
    assert codes == [-signal.SIGTERM]
    started.release()


def test_a_program_that_cannot_be_started_is_an_error() -> None:
    with pytest.raises(FileNotFoundError):
        Child(["/no/such/program"], Watch(), lambda *_: None, lambda _: None)
    with pytest.raises(FileNotFoundError):
        run(["/no/such/program"], {}, 1024)


def test_a_signal_that_comes_while_a_command_is_started_ends_the_command(monkeypatch: pytest.MonkeyPatch) -> None:
    started: list[int] = []

    class Interrupting(subprocess.Popen):  # type: ignore[type-arg]
        def __init__(self, *arguments: Any, **more: Any) -> None:
            super().__init__(*arguments, **more)
            started.append(self.pid)
            interrupt()

    monkeypatch.setattr(subprocess, "Popen", Interrupting)
    with Interrupts() as interrupts, pytest.raises(Interrupted), interrupts.raised():
        run(["sleep", "600"], dict(os.environ), 1024)
    with pytest.raises(ChildProcessError):
        os.waitpid(started[0], 0)  # it has ended, and was waited for


@contextmanager
def signals_to_another_thread() -> Iterator[None]:
    """The kernel interrupts another thread, so that a system call of this one goes on.

    It is the same for a signal that comes just before the call: its handler is called after the call.
    """
    ended = threading.Event()
    other = threading.Thread(target=ended.wait)
    other.start()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
        ended.set()
        other.join()


def test_a_signal_that_comes_just_before_a_command_is_waited_for_ends_the_command() -> None:
    script = f"kill -INT {os.getpid()}; exec sleep 600"
    with Interrupts() as interrupts, pytest.raises(Interrupted), signals_to_another_thread(), interrupts.raised():
        run(["bash", "-c", script], dict(os.environ), 1024)


def test_a_signal_that_comes_just_before_a_wait_of_the_loop_ends_the_wait() -> None:
    with Interrupts() as interrupts, signals_to_another_thread():
        watch = Watch()
        interrupts.wake(watch)
        started, _, codes = child(watch, f"kill -INT {os.getpid()}; exec sleep 600")
        while not interrupts.received:
            watch.turn()
        assert codes == []
        started.release()
    assert interrupts.received == [signal.SIGINT]


def test_a_command_that_is_left_early_is_ended() -> None:
    script = f"kill -INT {os.getpid()}; exec sleep 600"
    with Interrupts() as interrupts, pytest.raises(Interrupted), interrupts.raised():
        run(["bash", "-c", script], dict(os.environ), 1024)
