"""`slidectl teleop`: move a base or a joint while a key of the terminal is pressed."""

from __future__ import annotations

import math
import select
import sys
from collections.abc import Sequence
from contextlib import suppress
from time import monotonic

import click

from slidectl.cli import completion, output
from slidectl.cli.commands import command, finite, positive_seconds
from slidectl.cli.context import Context
from slidectl.cli.topic_streams import SUBSCRIBERS, pause_remark, users_of
from slidectl.errors import Refused, SlidectlError, UsageError
from slidectl.extensions.viewing.commands.terminal_keys import terminal_keys
from slidectl.extensions.viewing.teleoperation import TWIST, BaseDriver, Driver, JointDriver
from slidectl.names import is_under

_REPEAT_S = 0.25
"""A repeating key counts as released after this many wall seconds without a repetition."""
_PUBLISH_EVERY_S = 0.1
"""Short enough for bases that stop without commands (`cmd_vel_timeout`)."""


@command(
    step=None,
    examples=["slidectl teleop", "slidectl teleop /cart/cmd_vel --speed 0.2", "slidectl teleop --joint joint1"],
)
@click.argument("topic", required=False, shell_complete=completion.topics)
@click.option("--joint", metavar="JOINT", help="Move this joint by the arrow keys.")
@click.option("--speed", type=float, callback=finite, metavar="X",
              help="To begin with: 0.5 m/s; of a joint 0.1 m/s, 0.5 rad/s, or an effort of 1.")  # fmt: skip
@click.option("--turn", type=float, callback=finite, default=1.0, show_default=True, metavar="X",
              help="Turning speed to begin with, rad/s.")  # fmt: skip
@click.option("--key-timeout", type=float, callback=positive_seconds, default=0.6, show_default=True, metavar="S",
              help="How long a key counts that does not repeat yet, s of wall time.")  # fmt: skip
@click.pass_obj
def teleop(
    ctx: Context, topic: str | None, joint: str | None, speed: float | None, turn: float, key_timeout: float
) -> None:
    """Drive a base, or move a joint, by keys.

    The keys of a base are those of teleop_twist_keyboard, for a TOPIC of geometry_msgs/Twist, the only one where none
    is given. A joint is moved by the controller that runs for it alone: its set point, velocity or effort. All stops
    when the key is let go, with any other key, when the terminal is closed, and at the end.
    """
    if topic is not None and joint is not None:
        raise UsageError("TOPIC is for a base; it does not go with --joint")
    if not sys.stdin.isatty():
        raise UsageError(
            "teleop reads keys from a terminal, and stdin is none", "for scripts: slidectl pub TOPIC -r 10"
        )
    driver: Driver
    if joint is not None:
        driver = JointDriver(ctx.client, joint, speed, ctx.namespace)
    else:
        driver = BaseDriver(_topic_of_base(ctx, topic), 0.5 if speed is None else speed, turn)
    ctx.say(pause_remark(ctx.call("/slidectl/status"), "nothing moves until it goes on"))
    _drive(ctx, driver, key_timeout)


def _topic_of_base(ctx: Context, text: str | None) -> str:
    """The topic of Twists that `text` means, or the only one. Raises as `find_topic`; UsageError, Refused."""
    if text is not None:
        found = ctx.find_topic(text, SUBSCRIBERS, with_field=False)
        if found.type != TWIST:
            raise UsageError(f"{found.topic} takes {found.type}; teleop publishes {TWIST}", "a joint: --joint JOINT")
        return found.topic
    topics = ctx.call("/rosapi/topics_for_type", {"type": TWIST})["topics"]
    heard = [topic for topic, nodes in users_of(ctx, topics, SUBSCRIBERS).items() if nodes]
    fitting = [topic for topic in heard if is_under(topic, ctx.namespace)]
    if not fitting:
        hint = "a robot with wheels: slidectl spawn cart; a joint: slidectl teleop --joint JOINT"
        raise Refused(f"nobody subscribes to a topic of {TWIST}", hint)
    if len(fitting) > 1:
        raise UsageError(f"several topics take {TWIST}: {', '.join(fitting)}", "name one: slidectl teleop TOPIC")
    return fitting[0]


def _drive(ctx: Context, driver: Driver, key_timeout: float) -> None:
    """Drive until a signal or an error. In all cases the last message is a stop."""
    client = ctx.client
    with terminal_keys() as keys:
        output.write(f"{driver.help}\npublishes on {driver.topic}")
        held, moves = "", False
        """The pressed key that moves something, and whether the last message moves something."""
        let_go = publish = math.inf
        try:
            while True:
                wait = None if math.isinf(let_go) else max(0.0, min(let_go, publish) - monotonic())
                ready = select.select([sys.stdin, client], (), (), wait)[0]
                if client in ready:  # raises NoDaemon when the daemon has ended
                    for _ in client.events(0.0):
                        pass
                pressed = keys() if sys.stdin in ready else []
                now, was_held = monotonic(), held
                for key in pressed:
                    is_held = driver.press(key)
                    let_go = now + (_REPEAT_S if key == held else key_timeout) if is_held else math.inf
                    held = key if is_held else ""
                if now >= let_go:
                    driver.stop()
                    held, let_go = "", math.inf
                if pressed or held != was_held or now >= publish:
                    # Publish only motions and the stop after them: other nodes may drive the same base or joint.
                    if (held or moves) and (message := driver.message()) is not None:
                        moves = True  # set before sending: an interrupted send may have succeeded
                        client.deliver(driver.topic, message)
                        moves = bool(held)
                    publish = now + _PUBLISH_EVERY_S if held else math.inf
                    _show(driver.text(), client.reasons)
        finally:
            driver.stop()
            if moves and (message := driver.message()) is not None:
                with suppress(SlidectlError):
                    client.deliver(driver.topic, message)
            with suppress(OSError, SlidectlError):  # the terminal may be closed
                output.write("")


def _show(text: str, reasons: Sequence[str]) -> None:
    line = "; ".join([text, *reasons])[: output.terminal_width() - 1]
    sys.stdout.write(f"\r{line}\033[K")
    sys.stdout.flush()
