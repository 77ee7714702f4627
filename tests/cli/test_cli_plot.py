"""`slidectl plot` and `slidectl controller plot`: files by what is in them, text, and live on a terminal."""

from __future__ import annotations

import csv
import io
import json
import math
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import CommandLine
from daemon_fixture import running_daemon
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.transforms import Bbox
from terminal import Terminal
from waiting import eventually

from slidectl import traces
from slidectl.extensions.recording.codec import of
from slidectl.extensions.recording.recording_files import create, opened
from slidectl.extensions.viewing.plots import Curve, Plot, as_file, as_text

STATES = "/slider/joint_states"
STATE = "/slider/joint1_position_controller/state"
COMMAND = "/slider/joint1_position_controller/command"
STARTED = ("joint_state_controller", "joint1_position_controller")
_ESCAPE = re.compile(r"\x1b\[[0-9;?]*[A-Za-z]")


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[CommandLine, Path]]:
    """A paused world, in which the slider has gone up for 2 s, and the recording of that."""
    path = tmp_path_factory.mktemp("run") / "run.bag"
    with running_daemon(paused=True) as runtime:
        slidectl = CommandLine(runtime.folder)
        slidectl.ok("spawn", "slider", "--controllers", "config/slider_control.yaml", "--start", *STARTED)
        slidectl.ok("pub", COMMAND, "0.8")
        slidectl.ok("record", STATES, STATE, "-O", str(path), "--duration", "2", "--detach")
        slidectl.until_subscribed(STATES)
        slidectl.ok("sim", "step", "--until", "3")
        eventually(lambda: path.exists() and '"damage": null' in slidectl("bag", "info", str(path), "--json").stdout)
        yield slidectl, path


def drawn_paths(svg: str) -> list[str]:
    """The data of the path of each curve."""
    return re.findall(r'<g id="curve\d+">\s*<path d="([^"]*)"', svg)


def test_a_recording_becomes_an_svg_with_units_and_legends_and_always_the_same_bytes(
    run: tuple[CommandLine, Path], tmp_path: Path
) -> None:
    slidectl, bag = run
    fields = ("joint_states/position", "joint1_position_controller/state/{set_point,error}")
    for name in ("one.svg", "two.svg"):
        slidectl.ok("plot", str(bag), *fields, "--save", str(tmp_path / name))
    svg = (tmp_path / "one.svg").read_text()
    assert svg == (tmp_path / "two.svg").read_text()
    assert len(drawn_paths(svg)) == 3
    for text in ("/slider", "joint_states/position[0] (joint1)", "rad or m", "time (s)"):
        assert f">{text}</text>" in svg
    assert "joint1_position_controller/state/set_point" in svg
    assert str(tmp_path) not in svg


def test_each_format_has_the_curve(run: tuple[CommandLine, Path], tmp_path: Path) -> None:
    from matplotlib.image import imread

    slidectl, bag = run
    names = {suffix.lower(): str(tmp_path / f"plot.{suffix}") for suffix in ("PNG", "pdf", "html", "CSV")}
    for name in names.values():
        slidectl.ok("plot", str(bag), "joint_states/position[0]", "--save", name, "--size", "640x480")
    picture = imread(names["png"])
    assert picture.shape[:2] == (480, 640)
    blue = np.abs(picture[:, :, :3] - [0.122, 0.467, 0.706]).max(axis=2) < 0.02
    columns = np.flatnonzero(blue.any(axis=0))
    assert columns.max() - columns.min() > 400
    assert Path(names["pdf"]).read_bytes().startswith(b"%PDF")
    page = Path(names["html"]).read_text()
    assert len(drawn_paths(page)) == 1
    assert page.count("<svg") == 1
    assert "src=" not in page
    rows = list(csv.reader(Path(names["csv"]).read_text().splitlines()))
    with opened(bag) as recording:
        trace = traces.recorded(recording, "joint1")
    assert rows[0] == ["%time", f"{STATES}/position[0]"]
    assert [float(value) for _, value in rows[1:]] == trace.values.tolist()
    assert [int(time) for time, _ in rows[1:]] == [round(time * 1e9) for time in trace.times]
    again = slidectl.ok("plot", names["csv"], "position[0]", "--json")
    assert json.loads(again)["samples"] == len(trace.times)


def test_nan_is_a_gap_in_the_csv_of_echo(slidectl: CommandLine, tmp_path: Path) -> None:
    table, svg = tmp_path / "echo.csv", tmp_path / "gap.svg"
    values = [str(number) if number != 10 else "nan" for number in range(20)]
    rows = [f"{number * 10**9},{number},a,{value}" for number, value in enumerate(values)]
    table.write_text("%time,field.header.seq,field.name0,field.x\n" + "\n".join(rows) + "\n")
    slidectl.ok("plot", str(table), "--save", str(svg))
    (path,) = drawn_paths(svg.read_text())
    assert path.count("M") == 2
    assert "field.x" in slidectl.ok("plot", str(table))


@pytest.mark.parametrize(
    ("words", "samples"),
    [
        ((), {"/a/x": 2, "field.p0": 3, "field.p1": 1}),
        (("p",), {"field.p0": 3, "field.p1": 1}),
        (("topic/p[1]", "x"), {"field.p1": 1, "/a/x": 2}),
    ],
)
def test_the_columns_of_a_csv_are_read_wherever_they_have_their_first_value(
    slidectl: CommandLine, tmp_path: Path, words: tuple[str, ...], samples: dict[str, int]
) -> None:
    table = tmp_path / "holes.csv"
    table.write_text("%time,/a/x,field.n,field.p0\n0,,,1\n1,2,word,\n2,3,,3\n%time,field.p0,field.p1\n3,4,5\n")
    lines = slidectl.ok("plot", str(table), *words, "--json").splitlines()
    assert {one["name"]: one["samples"] for one in map(json.loads, lines)} == samples


@pytest.mark.parametrize(
    ("content", "words", "code", "told"),
    [
        (b"%time,a,b\n0,1,\n1,2,\n", ("--xy", "a", "b"), 1, "no values of b in bad.csv"),
        (b"%time,a,b\n0,1,\n1,2,\n", ("b",), 1, "no values of b in bad.csv"),
        (b"%time,a\n0,\n", (), 1, "no values in bad.csv"),
        (b"%time,a\n0,\xff\n", (), 2, "bad.csv: this is not UTF-8 text"),
        (b"%time,a\n1" + 400 * b"0" + b",1\n", (), 2, "bad.csv:2: the time is too large"),
        (b"%time,/a/p[0],/b/p[0]\n0,1,2\n", ("p",), 2, "'p' fits more than one column: /a/p, /b/p"),
        (b"%time,a\n0,1\n", ("c",), 1, "no column 'c'"),
    ],
)
def test_what_cannot_be_plotted_of_a_csv_is_told(
    slidectl: CommandLine, tmp_path: Path, content: bytes, words: tuple[str, ...], code: int, told: str
) -> None:
    (tmp_path / "bad.csv").write_bytes(content)
    done = slidectl("plot", "bad.csv", *words, cwd=tmp_path)
    assert done.returncode == code
    assert told in done.stderr
    assert "--ns" not in done.stderr


def test_values_without_an_axis_are_gaps(slidectl: CommandLine, tmp_path: Path) -> None:
    table, svg = tmp_path / "large.csv", tmp_path / "large.svg"
    table.write_text("%time,a\n0,1e308\n1,-1e308\n2,1e299\n3,-1e299\n")
    slidectl.ok("plot", str(table))
    slidectl.ok("plot", str(table), "--save", str(svg))
    (path,) = drawn_paths(svg.read_text())
    assert path.count("M") + path.count("L") == 2


def test_all_panels_have_one_time_axis_and_one_window(slidectl: CommandLine, tmp_path: Path) -> None:
    table = tmp_path / "two.csv"
    rows = [f"{number * 10**9},{number},{number if number < 8 else ''}" for number in range(11)]
    table.write_text("%time,a,b\n" + "\n".join(rows) + "\n")
    words = ("plot", str(table), "--panels", "each", "--window", "4")
    lines = [line.split() for line in slidectl.ok(*words).splitlines()]
    axes = [line for line in lines if line[:1] == ["6"] and line[-1] == "10"]
    assert len(axes) == 2
    assert axes[0] == axes[1]
    one, two = map(json.loads, slidectl.ok(*words, "--json").splitlines())
    assert (one["start"], one["end"], two["start"], two["end"]) == (6, 10, 6, 7)


def test_two_million_samples_keep_their_peaks_in_a_small_file() -> None:
    values = np.zeros(2_000_000)
    values[1_234_567] = 5.0
    plot = Plot("", [Curve("/a/b", times=np.arange(len(values)) * 1e-3, values=values)])
    svg = as_file(plot, ".svg")
    assert len(svg) < 300_000
    heights = [float(y) for y in re.findall(r"[ML] [\d.]+ ([\d.]+)", drawn_paths(svg.decode())[0])]
    assert max(heights) - min(heights) > 100


def test_two_recordings_and_two_fields_are_compared(run: tuple[CommandLine, Path], tmp_path: Path) -> None:
    slidectl, bag = run
    other = tmp_path / "other.bag"
    slidectl.ok("bag", "filter", str(bag), str(other), "True")
    lines = slidectl.ok("plot", "--compare", str(bag), str(other), "joint_states/velocity[0]", "--json").splitlines()
    one, two = map(json.loads, lines)
    assert {key: one[key] for key in ("start", "max", "last")} == {key: two[key] for key in ("start", "max", "last")}
    with opened(bag) as recording:
        begin = recording.summary().begin_ns
    now = json.loads(slidectl.ok("plot", str(bag), "joint_states/velocity[0]", "--json"))
    assert one["start"] == pytest.approx(now["start"] - begin / 1e9)
    assert one["name"].endswith("run.bag")
    phase = tmp_path / "phase.svg"
    slidectl.ok("plot", str(bag), "--xy", "joint_states/position[0]", "joint_states/velocity[0]", "--save", str(phase))
    svg = phase.read_text()
    assert len(drawn_paths(svg)) == 1
    assert ">position[0] (joint1) (rad or m)</text>" in svg
    assert ">velocity[0] (joint1) (rad/s or m/s)</text>" in svg


@pytest.mark.parametrize(
    ("words", "code", "says"),
    [
        (("joint_states/name",), 2, "is string, which is not a number"),
        (("joint_states/positon",), 1, "Did you mean 'position'?"),
        (("joint_state/position",), 1, "/slider/joint_states"),
        (("joint_states/position[4]",), 1, "index out of range"),
        (("joint_states/position", "--save", "x.gif"), 2, ".svg, .png, .pdf, .html, .csv"),
        (("joint_states/position", "--save", "/no/such/x.svg"), 1, "no folder /no/such"),
        (("joint_states/position", "--size", "99x600"), 2, "from 100x100 to 9999x9999"),
        ((), 2, "no FIELD"),
    ],
)
def test_what_cannot_be_plotted_is_told(
    run: tuple[CommandLine, Path], words: tuple[str, ...], code: int, says: str
) -> None:
    slidectl, bag = run
    done = slidectl("plot", str(bag), *words)
    assert done.returncode == code
    assert says in done.stderr
    assert "Traceback" not in done.stderr


def test_an_empty_recording_and_a_missing_library_are_told(slidectl: CommandLine, tmp_path: Path) -> None:
    empty = tmp_path / "empty.bag"
    writer = create(empty)
    writer.add(STATES, of("sensor_msgs/JointState"), False)
    writer.close()
    done = slidectl("plot", str(empty), "joint_states/position")
    assert done.returncode == 1
    (tmp_path / "matplotlib.py").write_text("raise ImportError")
    (tmp_path / "plotext.py").write_text("raise ImportError")
    search = f"{tmp_path}:{slidectl.environment['PYTHONPATH']}"
    for words, library in ((("--save", "x.svg"), "matplotlib"), ((), "plotext")):
        done = slidectl("plot", str(empty), "joint_states/position", *words, PYTHONPATH=search)
        assert done.returncode == 1
        assert library in done.stderr
        assert "[plot]'" in done.stderr


@pytest.mark.parametrize(
    ("words", "code", "told"),
    [
        (("joint_states/position[0]", "/quiet/data"), 0, "no message of /quiet in 0.5 s"),
        (("/quiet/data",), 1, "no message of /quiet in 0.5 s"),
        (("--xy", "joint_states/position[0]", "/quiet/data"), 1, "no message of /quiet in 0.5 s"),
    ],
)
def test_topics_without_a_message_are_told_and_the_others_are_drawn(
    run: tuple[CommandLine, Path], words: tuple[str, ...], code: int, told: str
) -> None:
    slidectl, _ = run
    with slidectl.client() as client:
        client.advertise("/quiet", "std_msgs/Float64")
        client.flush()
        process = slidectl.start("plot", *words, "--for", "0.5", "--json")
        slidectl.until_subscribed("/quiet")
        slidectl.ok("sim", "step", "600")
        out, err = process.communicate(timeout=60)
    assert process.returncode == code
    assert (f"{STATES}/position[0]" in out) == (code == 0)
    assert told in err


@pytest.fixture(scope="module")
def moving() -> Iterator[CommandLine]:
    """A world that runs as fast as it can."""
    with running_daemon(rtf=math.inf) as runtime:
        slidectl = CommandLine(runtime.folder)
        slidectl.ok("spawn", "slider", "--controllers", "config/slider_control.yaml", "--start", *STARTED)
        yield slidectl


def test_a_plot_is_live_on_a_terminal_and_stays_there_at_the_end(moving: CommandLine) -> None:
    fields = f"{STATE}/{{set_point,process_value,command}}"
    moving.ok("sim", "speed", "1")
    try:
        seen = moving.on_a_terminal("plot", fields, "--for", "1.5").decode()
        narrow = moving.on_a_terminal(
            "plot", "-q", fields, "--for", "1", COLUMNS="20", LINES="12", NO_COLOR="1"
        ).decode()
    finally:
        moving.ok("sim", "speed", "max")
    live, _, last = seen.partition("\x1b[?1049l")
    assert live.count("\x1b[H") >= 2
    for text in (STATE, "set_point", "process_value", "command", "[m]", "[N]", "time (s)"):
        assert text in last
    lines = _ESCAPE.sub("", narrow.partition("\x1b[?1049l")[2]).splitlines()
    assert "a: set_point" in lines[1] or "a: set_point" in lines[2]
    assert max(map(len, lines)) <= 20


def test_a_terminal_that_is_closed_ends_a_live_plot_as_an_interrupt(moving: CommandLine) -> None:
    with Terminal(moving, "plot", f"{STATES}/position[0]") as terminal:
        terminal.says("position[0]")
        terminal.close()
        assert terminal.process.wait(60) == 130


def test_a_plot_in_a_pipe_is_drawn_once_without_colours(moving: CommandLine) -> None:
    text = moving.ok("plot", f"{STATES}/position[0]", "--for", "0.5")
    assert "\x1b" not in text
    assert "position[0] (joint1)  [m]" in text
    assert text.count("time (s)") == 1


def test_what_arrived_before_the_daemon_ended_is_saved(tmp_path: Path) -> None:
    with running_daemon(paused=True) as runtime:
        slidectl, saved = CommandLine(runtime.folder), tmp_path / "gone.csv"
        slidectl.ok("spawn", "slider", "--controllers", "config/slider_control.yaml", "--start", *STARTED)
        process = slidectl.start("plot", f"{STATES}/position[0]", "--for", "100", "--save", str(saved))
        slidectl.until_subscribed(STATES)
        slidectl.ok("sim", "step", "500")
        runtime.stop()
        out, err = process.communicate(timeout=60)
    assert process.returncode == 3
    assert "gone.csv: 1 curve, 24 samples" in out
    assert "daemon" in err
    assert len(list(csv.reader(io.StringIO(saved.read_text())))) == 25


def test_a_plot_that_is_terminated_leaves_the_terminal_as_it_was_and_saves_what_came(
    run: tuple[CommandLine, Path], tmp_path: Path
) -> None:
    slidectl, saved = run[0], tmp_path / "part.csv"
    seen = slidectl.on_a_terminal("plot", f"{STATES}/position[0]", end_at=b"\x1b[H")
    assert seen.count(b"\x1b[?1049h") == seen.count(b"\x1b[?1049l") == 1
    assert b"paused" in seen.partition(b"\x1b[?1049h")[2].partition(b"\x1b[?1049l")[0]
    process = slidectl.start("plot", f"{STATES}/position[0]", "--for", "100", "--save", str(saved))
    slidectl.until_subscribed(STATES)
    slidectl.ok("sim", "step", "500")
    process.terminate()
    out, _ = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "part.csv: 1 curve" in out
    assert len(saved.read_text().splitlines()) > 10


def test_the_response_of_a_controller_to_a_step_is_one_picture_with_its_measures(
    moving: CommandLine, tmp_path: Path
) -> None:
    picture = tmp_path / "step.svg"
    words = ("controller", "plot", "joint1_position_controller", "--step", "1.0", "--for", "12")
    measured = json.loads(moving.ok(*words, "--save", str(picture), "--json"))
    assert measured["unit"] == "m"
    assert measured["overshoot"] < 1
    assert 0 < measured["rise"] < measured["settling"] < 12
    assert measured["effort_peak"] == 100
    svg = picture.read_text()
    assert len(drawn_paths(svg)) == 4
    # The effort chatters at the speed limit: its mean, and a band.
    curves = ("set_point", "process_value (position of joint1)", "error", "effort (joint1): mean", "where it chatters")
    readings = ("10 %", f"90 %: rise {measured['rise']:.3g} s", f"settling {measured['settling']:.3g} s")
    for text in (*curves, *readings, "m", "N", "0", "12", "time from the step (s)"):
        assert f">{text}</text>" in svg
    assert "overshoot 0 %</text>" not in svg
    assert re.search(r">rise [\d.]+ s, overshoot ", svg)
    moving.ok("controller", "stop", "joint1_position_controller")
    stopped = moving(*words)
    moving.ok("controller", "start", "joint1_position_controller")
    assert stopped.returncode == 1
    assert "does not run" in stopped.stderr


def test_measures_of_a_step_are_marked_in_the_terminal_and_a_table_keeps_simulated_time(
    moving: CommandLine, tmp_path: Path
) -> None:
    words = ("controller", "plot", "joint1_position_controller", "--for", "12")
    lines = moving.ok(*words, "--step", "0.5", COLUMNS="100", LINES="40").splitlines()
    key = next(number for number, line in enumerate(lines) if "● 10 %, 90 %: rise, settling" in line)
    panel = lines[key + 1 : next(n for n, line in enumerate(lines) if line.startswith("error  ["))]
    assert sum(line.count("●") for line in panel) == 3
    assert any(line.split() == ["0", "2", "4", "6", "8", "10", "12"] for line in panel)
    table = tmp_path / "step.csv"
    began = json.loads(moving.ok(*words, "--step", "0.4", "--save", str(table), "--json"))["start"]
    assert int(table.read_text().splitlines()[1].split(",")[0]) * 1e-9 == pytest.approx(began, abs=0.01)


def test_a_plot_of_what_is_at_rest_says_how_to_see_a_motion(moving: CommandLine, tmp_path: Path) -> None:
    moving.ok("sim", "step", "20s")
    moving.ok("sim", "resume")
    field, saved = f"{STATES}/position[0]", str(tmp_path / "rest.svg")
    told = moving("plot", field, "--for", "1", "--save", saved).stderr
    assert "all values stood still" in told
    assert f"slidectl record {STATES} -O run.bag, then slidectl plot run.bag '{field}'" in told
    moving.ok("sim", "pause")
    process = moving.start("plot", field, "--for", "10", "--save", saved)
    moving.until_subscribed(STATES)
    moving.ok("pub", COMMAND, "0.1")
    moving.ok("sim", "step", "11s")
    _, err = process.communicate(timeout=60)
    assert process.returncode == 0
    assert "stood still" not in err


def legend(axis: Axes) -> Bbox:
    """Where the legend of a panel is, in pixels."""
    found = axis.get_legend()
    assert found is not None
    return found.get_window_extent()


@pytest.mark.parametrize("count", [1, 5, 12])
def test_legends_are_beside_the_panels(count: int, monkeypatch: pytest.MonkeyPatch) -> None:
    drawn: list[Figure] = []
    save = Figure.savefig

    def noted(figure: Figure, *args: Any, **more: Any) -> None:
        drawn.append(figure)
        save(figure, *args, **more)

    monkeypatch.setattr(Figure, "savefig", noted)
    names = [f"/robot/joint_states/position[{number}] (joint{number})" for number in range(count)]
    as_file(Plot("", [Curve(name, times=np.arange(9.0), values=np.arange(9.0)) for name in names]), ".png")
    (axis,) = drawn[0].axes
    assert legend(axis).y0 >= axis.get_window_extent().y1 - 1
    assert legend(axis).x1 <= 960


@pytest.mark.parametrize(
    ("low", "high", "texts"),
    [
        (0.0, 12.0, ["0.0", "2.5", "5.0", "7.5", "10.0"]),
        (1210.31, 1214.3, ["1211", "1212", "1213", "1214"]),
        (-1.431, 0.7306, ["-1.0", "-0.5", "0.0", "0.5"]),
        (0.5, 0.5, ["0.46", "0.48", "0.50", "0.52", "0.54"]),
        (0.0, 4e9, ["0", "1e+09", "2e+09", "3e+09", "4e+09"]),
        (1e-7, 9e-7, ["2e-07", "4e-07", "6e-07", "8e-07"]),
    ],
)
def test_ticks_in_the_terminal_are_round(low: float, high: float, texts: list[str]) -> None:
    curve = Curve("/a/b", times=np.array([low, high]), values=np.zeros(2))
    lines = as_text(Plot("", [curve]), 80, 20, colour=False).splitlines()
    assert lines[-2].split() == texts


def test_a_topic_that_begins_with_an_underscore_is_drawn_without_a_legend() -> None:
    curve = Curve("_x/data", times=np.arange(9.0), values=np.arange(9.0))
    assert as_file(Plot("", [curve]), ".svg").startswith(b"<?xml")
