"""What comes before the first node: a look for what is not there, rosparam's commands, all parameters in one batch."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence

from slidectl.description import source_note
from slidectl.description.packages import Packages
from slidectl.errors import Refused, SlidectlError, UsageError
from slidectl.launch.plan import Leaf, Place, Plan, RosparamCommand
from slidectl.launch.task import Run, Task
from slidectl.writing import write_whole


def look_ahead(plan: Plan, tasks: Sequence[Task], packages: Packages, run_commands: bool = True) -> Mapping[str, Leaf]:
    """The parameters of a plan, after everything was noted that it needs and is not there, as far as files tell.

    Raises:
        NotThere: all of that, unless it is forgiven. BadFile: a value cannot be had.
    """
    parameters = plan.parameters(gather=True, run_commands=run_commands)
    for task in tasks:
        task.look_ahead(plan, packages, parameters)
    plan.missing.refuse()
    return parameters


def prepare(run: Run, parameters: Mapping[str, Leaf]) -> None:
    """Raises Refused with the place of what cannot be done."""
    _tell_notices(run)
    for command in run.plan.commands:
        _carry_out(run, command)
    for namespace, place in run.plan.clear:
        _clear(run, namespace, place)
    _set(run, parameters)
    if parameters:
        plural = "" if len(parameters) == 1 else "s"
        run.console.step("parameters", f"{len(parameters)} parameter{plural} set", count=len(parameters))


def _tell_notices(run: Run) -> None:
    """What the files say that is wrong in full, the rest counted unless `-v`."""
    quiet = 0
    for notice in run.plan.notices:
        if notice.verdict == "wrong" or run.console.verbose:
            run.console.warn(str(notice))
        else:
            quiet += 1
    if quiet:
        things = "one thing" if quiet == 1 else f"{quiet} things"
        run.console.step("notices", f"{things} in the files without effect, -v shows more", count=quiet)


def _clear(run: Run, namespace: str, place: Place) -> None:
    if run.call("/rosapi/has_param", {"name": namespace})["exists"]:
        _ask(run, place, "delete_param", name=namespace)


def _carry_out(run: Run, command: RosparamCommand) -> None:
    if not run.call("/rosapi/has_param", {"name": command.name})["exists"]:
        run.console.warn(
            f"{command.place}: <rosparam>: {command.name} is not set, so there is nothing to {command.verb}"
        )
        if command.verb == "delete":
            return
    if command.verb == "delete":
        _ask(run, command.place, "delete_param", name=command.name)
        return
    import yaml

    text = yaml.safe_dump(run.parameter(command.name) or {}, allow_unicode=True, default_flow_style=False)
    try:
        write_whole(command.file, text)
    except OSError as error:
        raise Refused(f"{command.place}: <rosparam>: cannot write {command.file}: {error.strerror}") from None


def _set(run: Run, parameters: Mapping[str, Leaf]) -> None:
    calls = [(name, place, _begin(run, name, value, place)) for name, (value, place) in parameters.items()]
    for name, place, call in calls:
        try:
            run.client.answer(call)
        except Refused as error:
            raise Refused(f"{place}: parameter {name}: {error.message}", error.hint) from None


def _begin(run: Run, name: str, value: object, place: Place) -> str:
    """The id of the call."""
    if isinstance(value, str):
        value = _without_note(run, value)
    text = _as_json(name, value, place)
    try:
        return run.client.call_async("/rosapi/set_param", {"name": name, "value": text})
    except UsageError as error:  # too long for a line
        raise place.error(f"parameter {name}: {error.message}") from None


def _without_note(run: Run, text: str) -> str:
    """A robot's description as any reader takes it; the daemon keeps beside it where its elements were written."""
    urdf, note = source_note.split(text)
    if note:
        run.client.call_async("/slidectl/sources", {"digest": source_note.digest(urdf), "note": note})
    return urdf


def _as_json(name: str, value: object, place: Place) -> str:
    try:
        return json.dumps(value, allow_nan=False)
    except ValueError:
        raise place.error(f"parameter {name}: {value} is no finite number, and parameters hold no others") from None


def _ask(run: Run, place: Place, verb: str, **request: object) -> None:
    try:
        run.call(f"/rosapi/{verb}", request)
    except SlidectlError as error:
        raise Refused(f"{place}: {error.message}", error.hint) from None
