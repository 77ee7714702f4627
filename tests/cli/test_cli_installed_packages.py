"""What installed packages add to slidectl, by the package of examples/packages, and by packages that are broken."""

from __future__ import annotations

import json
import os
import socket
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from command_line import ROOT, CommandLine, Done
from daemon_fixture import Runtime
from installed_package import WORKSHOP, install, write_package

from slidectl.extensions.gateways.gateway_kinds import OURS

COMMANDS, GATEWAYS, STEPS = "slidectl.commands", "slidectl.gateways", "slidectl.steps"
HELLO = """
import click
from slidectl.cli import command, group, CommandStep

@command(examples=["slidectl hello"])
def hello():
    '''Greet.'''
    click.echo("hello")

@command(step=None, examples=["slidectl lonely"])
def lonely():
    '''Do nothing.'''

@command(examples=["slidectl failing"])
def failing():
    '''Fail.'''
    {}["no"]

@command(examples=["slidectl leaving"])
def leaving():
    '''Leave.'''
    raise SystemExit(7)

@group(examples=["slidectl crowd all"])
def crowd():
    '''Greet many.'''

@crowd.command(examples=["slidectl crowd all"])
def all():
    '''Greet all.'''
    click.echo("hello all")
"""
HELLOS = {name: f"hello_commands:{name}" for name in ("hello", "lonely", "failing", "leaving", "crowd")}


class Installed(CommandLine):
    """The command line with a folder of packages of its own."""

    def __init__(self, runtime: Path, site: Path) -> None:
        super().__init__(runtime)
        self.site = site
        self.environment["PYTHONPATH"] = f"{site}:{self.environment['PYTHONPATH']}"

    def add(self, name: str, group: str, points: dict[str, str], **modules: str) -> None:
        write_package(self.site, name, {group: points}, modules)


@pytest.fixture
def packages(tmp_path: Path) -> Iterator[Installed]:
    """No packages, and no daemon; one that runs at the end is stopped."""
    runtime = Runtime()
    try:
        installed = Installed(runtime.folder, tmp_path / "site")
        yield installed
        installed("daemon", "stop")
    finally:
        runtime.remove()


@pytest.fixture
def workshop(packages: Installed) -> Installed:
    install(WORKSHOP, packages.site)
    return packages


@pytest.fixture
def hello(packages: Installed) -> Installed:
    packages.add("slidectl-hello", COMMANDS, HELLOS, hello_commands=HELLO)
    return packages


@pytest.fixture
def scenario(tmp_path: Path) -> Callable[..., str]:
    def write(*steps: str) -> str:
        file = tmp_path / "scenario.yaml"
        file.write_text("steps:\n" + "".join(f"  - {step}\n" for step in steps), encoding="utf-8")
        return str(file)

    return write


def refused(done: Done, code: int = 1) -> str:
    assert (done.returncode, done.stdout) == (code, ""), done.stderr
    assert "Traceback" not in done.stderr
    return done.stderr


# -- the package of the examples ---------------------------------------------------------------------------------------


def test_a_package_adds_a_command_and_a_verb(workshop: Installed) -> None:
    assert workshop.ok("nudge", "--help").startswith("Usage: slidectl nudge [OPTIONS] JOINT EFFORT\n")
    workshop.ok("daemon", "start", "--paused")
    workshop.ok("spawn", "slider")
    pushed = workshop.ok("nudge", "joint1", "5", "--json")
    assert json.loads(pushed) == {"joint": "joint1", "effort": 5.0, "seconds": 0.1}
    workshop.ok("sim", "step", "100")
    with workshop.client() as client:
        assert client.call("/gazebo/get_joint_properties", {"joint_name": "joint1"})["rate"][0] > 0.0
    assert workshop.ok("sim", "now") == "0.100\n"
    assert "no joint 'nosuch'" in refused(workshop("nudge", "nosuch", "5"))


def test_a_package_adds_a_gateway(workshop: Installed) -> None:
    workshop.ok("daemon", "start", "--paused")
    address = json.loads(workshop.ok("gateway", "udp", "start", "--port", "0", "--topic", "/number", "--json"))[
        "address"
    ]
    with workshop.client() as client, client.subscribe("/number", "std_msgs/Float64") as numbers:
        with socket.socket(type=socket.SOCK_DGRAM) as udp:
            udp.settimeout(30)
            udp.connect(("127.0.0.1", int(address.rpartition(":")[2])))
            for datagram, answer in ((b"far", "error: could not convert string to float: b'far'"), (b"1.5", "ok")):
                udp.send(datagram)
                assert udp.recv(1000).decode() == answer
        assert numbers.get(timeout=30) == {"data": 1.5}
    state = json.loads(workshop.ok("gateway", "status", "--json"))
    assert (state["kind"], state["received"]) == ("udp", 2)
    assert workshop.ok("gateway", "udp", "stop").startswith("udp gateway: stopped, it was process ")
    assert "no udp gateway runs" in refused(workshop("gateway", "udp", "status"))


def test_a_gateway_of_a_package_starts_and_stops_with_the_daemon(workshop: Installed) -> None:
    started = workshop.ok("daemon", "start", "--gateway", "udp", "--json").splitlines()
    assert json.loads(started[1])["address"] == "udp://127.0.0.1:9870"
    workshop.ok("daemon", "stop")
    assert workshop("gateway", "status").stderr == "no gateway runs\n"


def test_an_unknown_gateway_starts_no_daemon(packages: Installed) -> None:
    assert refused(packages("daemon", "start", "--gateway", "udp")) == (
        f"error: no gateway 'udp'.\ngateways: {', '.join(sorted(OURS))}\n"
    )
    assert packages("daemon", "status").returncode == 3


def model(tmp_path: Path, sensor: str) -> str:
    """A slider whose base carries a sensor half a metre above the ground."""
    text = (ROOT / "models" / "slider.xacro").read_text(encoding="utf-8")
    tag = f'<gazebo reference="base_link">{sensor}</gazebo></robot>'
    file = tmp_path / "model.xacro"
    file.write_text(text.replace("</robot>", tag), encoding="utf-8")
    return str(file)


CLEARANCE = """<sensor name="down" type="clearance"><update_rate>10</update_rate><topic>down</topic>
<pose>3 0 0.5 0 0 0</pose><range><max>{}</max></range></sensor>"""


def test_a_package_adds_a_sensor(workshop: Installed, tmp_path: Path) -> None:
    workshop.ok("daemon", "start", "--paused")
    workshop.ok("spawn", model(tmp_path, CLEARANCE.format(4)))
    echo = workshop.start("echo", "/slider/down", "-n", "1", "--json")
    workshop.until_subscribed("/slider/down")
    workshop.ok("sim", "step", "1000")
    heard = json.loads(echo.communicate(timeout=30)[0])
    message = heard.get("msg", heard)
    assert (message["header"]["frame_id"], message["max_range"]) == ("base_link", 4.0)
    assert message["range"] == pytest.approx(0.5, abs=0.2)
    checked = workshop("check", model(tmp_path, CLEARANCE.format(4)))
    [line] = [line for line in checked.stdout.splitlines() if 'type="clearance"' in line]
    assert line.split()[1] == "used"
    done = workshop("spawn", model(tmp_path, CLEARANCE.format("far")), "-n", "other")
    assert done.returncode != 0
    assert "<sensor>/<range/max>" in done.stderr
    assert json.loads(workshop.ok("robots", "--json"))["name"] == "slider"


def test_a_sensor_that_fails_stops_nothing_else(packages: Installed, tmp_path: Path) -> None:
    text = (
        "from slidectl.simulation import SensorKind\nclass Bad(SensorKind):\n    message_type = 'std_msgs/Float64'\n"
        "    def measure(self, view):\n        raise SystemExit('no')\n"
    )
    text += (
        "class Odd(SensorKind):\n    message_type = 'std_msgs/Float64'\n"
        "    def measure(self, view):\n        return {'range': 1.0}\n"
    )
    points = {"bad": "bad_sensor:Bad", "gone": "no_module:Gone", "odd": "bad_sensor:Odd"}
    packages.add("slidectl-bad", "slidectl.sensors", points, bad_sensor=text)
    packages.ok("daemon", "start", "--paused")
    file = model(tmp_path, '<sensor name="one" type="bad"/><sensor name="odd" type="odd"/><sensor type="none"/>')
    known = "sensors here are ray, gpu_ray, imu, contact, camera, bad, gone, odd, not 'none'"
    assert known in packages("check", file).stdout
    packages.ok("spawn", file)
    with packages.client() as client:
        for topic in ("/slider/one", "/slider/odd"):
            client.subscribe(topic, "std_msgs/Float64")
        client.step(3)
    log = packages.ok("daemon", "logs")
    assert log.count("sensor one: SystemExit: no") == 1
    assert "sensor odd: std_msgs/Float64: no field 'range'" in log
    assert log.count("the sensor stops measuring") == 2
    done = packages("spawn", model(tmp_path, '<sensor name="one" type="gone"/>'), "-n", "other")
    assert "the sensor 'gone' of slidectl-bad 1.0 cannot be loaded: ModuleNotFoundError" in refused(done)
    assert "pip uninstall slidectl-bad" in done.stderr


def test_a_package_adds_a_step(workshop: Installed, scenario: Callable[..., str]) -> None:
    begin = ("spawn: slider --controllers config/slider_control.yaml --start joint_state_controller", "nudge: joint1 9")
    file = scenario(*begin, "sim now", "at: 0.1", "{still: 0.02, within: 60}")
    done = workshop("test", file)
    assert "1 passed" in done.stdout, done.stdout + done.stderr
    file = scenario(*begin, "at: 0.1", "{still: 0.02, within: 0.01}")
    assert "not done within 0.01 s of simulated time" in workshop("test", file).stdout
    assert refused(workshop("test", scenario("still: fast")), 2) == (
        f"error: {file}:2: a speed is a number above 0, not 'fast'\n- still: 0.01\n"
    )
    assert "no step 'stil'. Did you mean 'still'?" in refused(workshop("test", scenario("stil: 1")), 2)
    step = json.loads(workshop.ok("test", "--schema"))["$defs"]["step"]["anyOf"][1]["properties"]
    assert step["still"]["description"] == "Wait until no joint is faster than this, in m/s or rad/s."
    assert {"nudge", "sim now"} <= set(step)


def test_what_packages_add_is_listed(workshop: Installed) -> None:
    for words, name in (((), "nudge"), (("sim",), "now"), (("gateway",), "udp")):
        section = workshop.ok(*words, "--help").partition("Installed packages:\n")[2].partition("\n\n")[0]
        assert section.split()[:3] == [name, "slidectl-workshop", "1.0:"]
    lines = [line for line in workshop.ok("doctor").splitlines() if "extensions:" in line]
    assert lines == [
        "ok         extensions: slidectl-workshop 1.0: "
        "command nudge, command sim.now, sensor clearance, gateway udp, step still"
    ]
    words = {"_SLIDECTL_COMPLETE": "bash_complete", "COMP_CWORD": "1"}
    assert "plain,nudge" in workshop("", COMP_WORDS="slidectl nu", **words).stdout
    assert "plain,now" in workshop("", COMP_WORDS="slidectl sim no", **(words | {"COMP_CWORD": "2"})).stdout


# -- commands ----------------------------------------------------------------------------------------------------------


def test_a_command_may_be_a_group_and_leaves_with_its_exit_code(hello: Installed) -> None:
    assert hello.ok("hello") == "hello\n"
    assert hello.ok("crowd", "all") == "hello all\n"
    assert hello("leaving").returncode == 7
    assert "Did you mean 'slidectl hello'?" in refused(hello("helo"), 2)


def test_a_command_that_raises_an_exception_is_the_fault_of_its_package(hello: Installed) -> None:
    assert refused(hello("failing")) == (
        f"error: the command 'failing' of slidectl-hello 1.0 failed: KeyError: 'no' "
        f"({hello.site}/hello_commands.py:17)\n"
        "this is a bug in slidectl-hello; -vv shows the traceback\n"
    )
    assert "Traceback" in hello("failing", "-vv").stderr


def test_a_command_says_itself_whether_it_can_be_a_step(hello: Installed, scenario: Callable[..., str]) -> None:
    assert "1 passed" in hello.ok("test", scenario("hello"))
    assert "lonely cannot be a step" in refused(hello("test", scenario("lonely")), 2)
    done = hello("test", scenario("failing"))
    assert (done.returncode, "slidectl-hello 1.0 failed: KeyError: 'no'" in done.stdout) == (1, True)
    done = hello("test", scenario("leaving"))
    assert (done.returncode, "exit code 7" in done.stdout) == (1, True)


# -- packages that are broken ------------------------------------------------------------------------------------------

BROKEN = {
    "raise RuntimeError('out of order')": "RuntimeError: out of order ({file}:1)",
    "raise SystemExit(3)": "SystemExit: 3 ({file}:1)",
    "import no_such_library": "ModuleNotFoundError: No module named 'no_such_library' ({file}:1)",
    "def (": "SyntaxError: invalid syntax (broken_part.py, line 1)",
    "x = 1": "AttributeError: module 'broken_part' has no attribute 'part'",
}


@pytest.mark.parametrize("text", BROKEN, ids=[text.split("(")[0].split("'")[0] for text in BROKEN])
def test_a_broken_package_is_named_and_stops_nothing_else(
    packages: Installed, scenario: Callable[..., str], text: str
) -> None:
    points = {group: {name: "broken_part:part"} for group, name in ((GATEWAYS, "radio"), (STEPS, "rest"))}
    points[COMMANDS] = {"sing": "broken_part:part", "sim.sing": "broken_part:part"}
    write_package(packages.site, "slidectl-broken", points, {"broken_part": text})
    cause = BROKEN[text].format(file=packages.site / "broken_part.py")

    def told(kind: str, name: str) -> str:
        return f"the {kind} {name!r} of slidectl-broken 1.0 cannot be loaded: {cause}"

    for kind, name, words in (
        ("command", "sing", ["sing"]),
        ("command", "sim.sing", ["sim", "sing"]),
        ("gateway", "radio", ["gateway", "radio"]),
        ("step", "rest", ["test", scenario("rest: 1")]),
    ):
        message = told(kind, name)
        said = refused(packages(*words), 2 if kind == "step" else 1)
        assert said.partition(": " if kind == "step" else "error: ")[2].endswith(
            f"{message}\npip uninstall slidectl-broken\n"
        )
    assert "sing" in packages.ok("--help")
    assert "sing" in packages.ok("sim", "--help")
    assert "radio" in packages.ok("gateway", "--help")
    assert packages.ok("version").startswith("slidectl ")
    assert "1 passed" in packages.ok("test", scenario("sim: status"))
    assert "$defs" in packages.ok("test", "--schema")
    doctor = packages("doctor", "--json")
    lines = [line for line in map(json.loads, doctor.stdout.splitlines()) if line["check"] == "extensions"]
    assert {(line["state"], line["finding"], line["remedy"]) for line in lines} == {
        ("broken", told(kind, name), "pip uninstall slidectl-broken")
        for kind, name in (("command", "sing"), ("command", "sim.sing"), ("gateway", "radio"), ("step", "rest"))
    }
    assert doctor.returncode == 1


def test_something_else_than_a_command_is_refused(packages: Installed) -> None:
    packages.add("slidectl-broken", COMMANDS, {"sing": "broken_part:part"}, broken_part="part = 1")
    assert refused(packages("sing")) == (
        "error: the command 'sing' of slidectl-broken 1.0 cannot be used: broken_part:part is not a command: "
        "decorate a function with slidectl.cli.command\npip uninstall slidectl-broken\n"
    )


def test_metadata_that_cannot_be_read_stops_nothing(hello: Installed) -> None:
    hello.add("slidectl-broken", COMMANDS, {})
    (hello.site / "slidectl_broken-1.0.dist-info" / "entry_points.txt").write_text(f"[{COMMANDS}]\nsing\n")
    assert hello.ok("hello") == "hello\n"
    assert "the entry points of slidectl-broken cannot be read" in hello("doctor").stdout


# -- names -------------------------------------------------------------------------------------------------------------


def test_a_name_of_slidectl_and_a_name_that_two_packages_claim_are_refused(hello: Installed) -> None:
    points = {"hello": "other:hello", "version": "other:hello", "sim.step": "other:hello", "no.verb": "other:hello"}
    hello.add("slidectl-other", COMMANDS, points, other=HELLO)
    assert refused(hello("hello")) == (
        "error: the command 'hello' of slidectl-hello 1.0 is not used: the name is also claimed by slidectl-other 1.0\n"
        "pip uninstall slidectl-hello or pip uninstall slidectl-other\n"
    )
    assert hello.ok("version").startswith("slidectl ")
    assert hello.ok("crowd", "all") == "hello all\n"
    words = " ".join(hello.ok("--help").split())
    assert "the command 'version' of slidectl-other 1.0 is not used: slidectl has one of that name" in words
    assert "the command 'hello' of slidectl-hello 1.0 is not used" in words
    assert "the command 'sim.step' of slidectl-other 1.0 is not used" in " ".join(hello.ok("sim", "--help").split())
    doctor = hello.ok("doctor")
    for name, why in (
        ("version", "slidectl has one of that name"),
        ("sim.step", "slidectl has one of that name"),
        ("no.verb", "slidectl has no group 'no'"),
    ):
        assert f"the command {name!r} of slidectl-other 1.0 is not used: {why}" in doctor


def test_a_group_of_entry_points_that_nothing_uses_is_told(packages: Installed) -> None:
    packages.add("slidectl-old", "slidectl.command", {"sing": "old:sing"})
    assert "nothing of slidectl uses the entry point 'sing' of the group slidectl.command" in packages.ok("doctor")


def test_of_two_versions_the_first_on_the_path_counts(hello: Installed, tmp_path: Path) -> None:
    write_package(tmp_path / "later", "slidectl-hello", {COMMANDS: {"hello": "older:hello"}}, {}, "0.9")
    hello.environment["PYTHONPATH"] += f":{tmp_path / 'later'}"
    assert hello.ok("hello") == "hello\n"


def test_a_file_of_entry_points_that_never_ends_is_passed_over(hello: Installed) -> None:
    for name, make in (("fifo", os.mkfifo), ("folder", os.mkdir), ("loop", lambda path: os.symlink(path, path))):
        (hello.site / f"{name}-1.0.dist-info").mkdir()
        make(hello.site / f"{name}-1.0.dist-info" / "entry_points.txt")
    assert hello.ok("hello") == "hello\n"
