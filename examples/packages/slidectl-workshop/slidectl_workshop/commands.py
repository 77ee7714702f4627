"""The commands `slidectl nudge` and `slidectl sim now`."""

import click

from slidectl.cli import Context, command
from slidectl.errors import Refused


@command(examples=["slidectl nudge joint1 5", "slidectl nudge joint1 -- -5 --for 0.2"])
@click.argument("joint")
@click.argument("effort", type=float)
@click.option("--for", "seconds", type=float, default=0.1, metavar="S", help="Simulated seconds (0.1).")
@click.pass_obj
def nudge(ctx: Context, joint: str, effort: float, seconds: float) -> None:
    """Push a joint for a moment.

    EFFORT is in N or N m. JSON keys: joint, effort, seconds.
    """
    secs, nsecs = divmod(round(seconds * 1e9), 10**9)
    duration = {"secs": secs, "nsecs": nsecs}
    push = {"joint_name": joint, "effort": effort, "duration": duration}
    answer = ctx.call("/gazebo/apply_joint_effort", push)
    if not answer["success"]:
        raise Refused(answer["status_message"])
    ctx.done({"joint": joint, "effort": effort, "seconds": seconds}, f"{joint}: pushed by {effort:g} for {seconds:g} s")


@command(examples=["slidectl sim now"])
@click.pass_obj
def now(ctx: Context) -> None:
    """Print the simulated time. JSON key: time, s."""
    time = float(ctx.call("/slidectl/status")["time"])
    ctx.emit({"time": time}, f"{time:.3f}")
