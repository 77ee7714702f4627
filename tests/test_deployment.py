"""action.yml, Dockerfile and the systemd unit: their commands are run, without the services they are for."""

from __future__ import annotations

import configparser
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import sysconfig
import tomllib
import venv
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import pytest
import yaml
from daemon_fixture import Runtime, shown
from waiting import eventually

from slidectl.errors import NoDaemon

ROOT = Path(__file__).parent.parent
BIN = Path(sys.executable).parent
LIMIT_S = 900
pytestmark = pytest.mark.timeout(1200)  # pip asks the index for what builds a wheel, and may wait for it


def action_steps() -> dict[str, dict[str, Any]]:
    """Those with a name, by it."""
    action = yaml.safe_load((ROOT / "action.yml").read_text(encoding="utf-8"))
    assert action["runs"]["using"] == "composite"
    return {step["name"]: step for step in action["runs"]["steps"] if "name" in step}


def run_step(step: dict[str, Any], values: dict[str, str], folder: Path, bin_folder: Path) -> int:
    """As GitHub does it: expressions become environment variables, and bash stops at the first failure."""
    variables = {
        name: re.sub(r"\$\{\{ (\S+) \}\}", lambda match: values[match[1]], text)
        for name, text in step.get("env", {}).items()
    }
    environment = {**os.environ, "PATH": f"{bin_folder}:{os.environ['PATH']}", **variables}
    shell = ["bash", "--noprofile", "--norc", "-e", "-o", "pipefail", "-c", step["run"]]
    return subprocess.run(shell, env=environment, cwd=folder, timeout=LIMIT_S).returncode


def known_pythons() -> list[str]:
    """The versions that pyproject.toml names."""
    classifiers = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["classifiers"]
    found = (re.fullmatch(r"Programming Language :: Python :: (3\.\d+)", one) for one in classifiers)
    return [match[1] for match in found if match]


def docker_lines() -> dict[str, list[str]]:
    """What stands behind each word of the Dockerfile."""
    lines: dict[str, list[str]] = {}
    for line in (ROOT / "Dockerfile").read_text(encoding="utf-8").splitlines():
        if line and not line.startswith("#"):
            word, _, rest = line.partition(" ")
            lines.setdefault(word, []).append(rest)
    return lines


@pytest.fixture
def bare(tmp_path: Path) -> Path:
    """The bin of an environment with all that slidectl needs, but without slidectl."""
    venv.create(tmp_path / "venv", with_pip=True, symlinks=True)
    [packages] = (tmp_path / "venv").glob("lib/python3*/site-packages")
    for entry in Path(sysconfig.get_paths()["purelib"]).iterdir():
        ours = entry.suffix == ".pth" or re.match(r"_?_?(slidectl|pip|editable)", entry.name)
        if not ours and not (packages / entry.name).exists():
            (packages / entry.name).symlink_to(entry)
    return tmp_path / "venv" / "bin"


@pytest.fixture
def sources(tmp_path: Path) -> Path:
    """A copy of what the repository holds."""
    ignored = shutil.ignore_patterns(".git", ".venv*", "__pycache__", "build", "dist", "results", ".*_cache")
    return Path(shutil.copytree(ROOT, tmp_path / "src", ignore=ignored))


def test_the_action_installs_slidectl(bare: Path, sources: Path, tmp_path: Path) -> None:
    assert not (bare / "slidectl").exists()
    step = action_steps()["Install slidectl"]
    assert run_step(step, {"github.action_path": str(sources)}, tmp_path, bare) == 0
    assert subprocess.run([bare / "slidectl", "version"], cwd=tmp_path, timeout=LIMIT_S).returncode == 0


def test_the_action_runs_scenarios_and_keeps_what_failed(tmp_path: Path) -> None:
    folder = tmp_path / "robots"
    folder.mkdir()
    shutil.copy(ROOT / "examples" / "scenarios" / "slider.yaml", folder)
    values = {
        "inputs.scenarios": "robots",
        "inputs.arguments": "-n 1 -k 'slider and not arm'",
        "inputs.results": "kept",
    }
    step = action_steps()["Run the scenarios"]
    assert run_step(step, values, tmp_path, BIN) == 0
    cases = ET.parse(tmp_path / "kept" / "results.xml").getroot().findall(".//testcase")
    assert cases
    assert [case for case in cases if case.find("failure") is not None] == []


def test_the_pythons_of_the_action_the_image_and_the_pages_are_those_that_are_tested() -> None:
    known = known_pythons()
    assert known == ["3.11", "3.12", "3.13"]
    [image] = docker_lines()["FROM"]
    assert image == f"python:{known[-1]}-slim"
    version = yaml.safe_load((ROOT / "action.yml").read_text(encoding="utf-8"))["inputs"]["python-version"]
    assert version["default"] == known[-1]
    assert re.findall(r"3\.\d+", version["description"]) == known
    assert f"image: {image}" in (ROOT / "docs" / "ci.md").read_text(encoding="utf-8")
    assert "Python 3.11, 3.12 or 3.13" in (ROOT / "README.md").read_text(encoding="utf-8")
    assert f"for version in {' '.join(known)} " in (ROOT / "scripts" / "pythons.sh").read_text(encoding="utf-8")


def test_what_the_page_gives_to_ci_servers_runs_scenarios(tmp_path: Path) -> None:
    page = (ROOT / "docs" / "ci.md").read_text(encoding="utf-8")
    blocks = re.findall(r"^```yaml\n(.*?)^```", page, re.MULTILINE | re.DOTALL)
    github, of_several, gitlab = map(yaml.safe_load, blocks)
    given = github["jobs"]["scenarios"]["steps"][-1]["with"]
    job = of_several["jobs"]["scenarios"]
    assert job["strategy"]["matrix"]["python"] == known_pythons()
    assert job["steps"][-1]["with"] == {"python-version": "${{ matrix.python }}"}
    inputs = yaml.safe_load((ROOT / "action.yml").read_text(encoding="utf-8"))["inputs"]
    assert given.keys() <= inputs.keys()
    (tmp_path / given["scenarios"]).mkdir()
    shutil.copy(ROOT / "examples" / "scenarios" / "slider.yaml", tmp_path / given["scenarios"])
    values = {f"inputs.{name}": str(given.get(name, entry.get("default"))) for name, entry in inputs.items()}
    assert run_step(action_steps()["Run the scenarios"], values, tmp_path, BIN) == 0
    install, test = gitlab["scenarios"]["script"]
    assert "pip install" in install
    assert run_step({"run": test}, {}, tmp_path, BIN) == 0
    assert (tmp_path / gitlab["scenarios"]["artifacts"]["reports"]["junit"]).exists()


def test_the_image_installs_slidectl_and_runs_it_as_a_user(bare: Path, sources: Path) -> None:
    lines = docker_lines()
    install = next(line for line in lines["RUN"] if "pip install" in line).replace("/src", str(sources))
    environment = {**os.environ, "PATH": f"{bare}:{os.environ['PATH']}"}
    assert subprocess.run(["sh", "-ec", install], env=environment, timeout=LIMIT_S).returncode == 0
    assert lines["USER"] == ["robot"]
    assert any(f"useradd --create-home {lines['USER'][0]}" in line for line in lines["RUN"])
    [entry], [command] = lines["ENTRYPOINT"], lines["CMD"]
    words = [*yaml.safe_load(entry), *yaml.safe_load(command)]
    assert shutil.which(words[0], path=str(bare)) == str(bare / "slidectl")
    stays_until_it_is_asked_to_end([str(bare / words[0]), *words[1:]], "default")


def test_the_containers_of_the_page_run_what_it_says(tmp_path: Path) -> None:
    """Without containers: what docker would run in each."""
    build, test, run, execute = shown("ci.md", "docker build")
    image = build[build.index("-t") + 1]
    lines = docker_lines()
    [entry], [command], [folder] = (lines[word] for word in ("ENTRYPOINT", "CMD", "WORKDIR"))
    assert f"$PWD:{folder}" in test
    (tmp_path / test[-1]).mkdir()
    shutil.copy(ROOT / "examples" / "scenarios" / "slider.yaml", tmp_path / test[-1])
    inside = [words[words.index(image) + 1 :] or yaml.safe_load(command) for words in (test, run)]
    testing, running = ([str(BIN / yaml.safe_load(entry)[0]), *words] for words in inside)
    assert subprocess.run(testing, cwd=tmp_path, timeout=LIMIT_S).returncode == 0
    assert execute[:3] == ["docker", "exec", run[run.index("--name") + 1]]
    stays_until_it_is_asked_to_end(running, "default", [str(BIN / execute[3]), *execute[4:]])


def test_the_unit_starts_a_daemon_that_ends_when_systemd_asks(tmp_path: Path) -> None:
    *put, enable = shown("ci.md", "systemctl")
    for words in put:
        home = [word.replace("~", str(tmp_path)) for word in words]
        subprocess.run(home, cwd=ROOT, check=True)
    instance = enable[-1].partition("@")[2]
    unit = configparser.ConfigParser(interpolation=None, strict=False)
    unit.optionxform = str  # type: ignore[assignment,method-assign]
    [file] = (tmp_path / ".config" / "systemd" / "user").iterdir()
    unit.read(file, encoding="utf-8")
    words = shlex.split(unit["Service"]["ExecStart"].replace("%i", instance))
    assert words[0] == "%h/.local/bin/slidectl"
    stays_until_it_is_asked_to_end([str(BIN / "slidectl"), *words[1:]], instance)


def answers(runtime: Runtime) -> bool:
    try:
        runtime.client().close()
    except NoDaemon:
        return False
    return True


def stays_until_it_is_asked_to_end(command: list[str], instance: str, beside: list[str] | None = None) -> None:
    """A daemon in the foreground, which answers, and ends with 0 at SIGTERM. Another command may run beside it."""
    runtime = Runtime(name=instance)
    try:
        process = subprocess.Popen(command, env=runtime.env, stderr=subprocess.PIPE, text=True)
        eventually(lambda: answers(runtime), "it does not answer")
        with runtime.client() as client:
            assert client.call("/slidectl/status")["instance"] == instance
        if beside:
            subprocess.run(beside, env=runtime.env, check=True, timeout=LIMIT_S)
        process.send_signal(signal.SIGTERM)
        _, errors = process.communicate(timeout=LIMIT_S)
        assert process.returncode == 0, errors
    finally:
        runtime.remove()
