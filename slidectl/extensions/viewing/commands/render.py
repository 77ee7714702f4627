"""`slidectl render` and `slidectl video`: pictures of the world, without a display."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from slidectl.cli import completion, output
from slidectl.cli.commands import command, finite, pixel_size, simulated_seconds
from slidectl.cli.context import Context
from slidectl.cli.topic_streams import pause_remark
from slidectl.errors import EXIT_INTERRUPTED, TimedOut, UsageError

if TYPE_CHECKING:
    from slidectl.extensions.viewing.drawing import WorldView
    from slidectl.extensions.viewing.picture_files import VideoFile

_LOOK_S = 1.0
"""Wall seconds without a picture, after which the command checks whether the world is paused."""
_HOLD_S = 60.0
"""Wall seconds for which a running world waits for a picture."""


def _looks(function: Callable[..., None]) -> Callable[..., None]:
    """Add the options of both commands."""
    for option in (
        click.option("--software", is_flag=True, help="Draw without OpenGL."),
        click.option("--camera", default="iso", show_default=True, metavar="CAMERA",
                     help="iso, front, top, side, follow:LINK, or a camera of a robot."),
        click.option("--size", default="800x600", show_default=True, metavar="WxH", callback=pixel_size(16, 4096),
                     help="Pixels from side to side, and from top to bottom."),
    ):  # fmt: skip
        function = option(function)
    return function


@command(examples=["slidectl render -o now.png", "slidectl render -o tip.png --camera follow:link3 --size 1280x720"])
@click.option("-o", "--output", "file", required=True, metavar="FILE", shell_complete=completion.files,
              help="The file, a .png.")  # fmt: skip
@_looks
@click.pass_obj
def render(ctx: Context, /, file: str, **given: Any) -> None:
    """Draw the world into a picture.

    Robots are drawn by their visuals, in the colours of their materials; one without any by what collides. 'front'
    looks against x, 'side' along y, 'top' down with y up, 'iso' from between; all of them show all robots. A camera of
    a robot is its name, or ROBOT::NAME. MuJoCo draws by OpenGL (EGL or OSMesa); where there is none, and with
    --software, it is drawn by software, a little plainer.

    JSON keys: file, width, height, time (simulated, s), camera, robots, drawn_by (OpenGL or software).
    """
    path = Path(file)
    if path.suffix.lower() != ".png":
        raise UsageError(f"{file} is no picture that can be written", "kinds: .png; videos: slidectl video")
    view = _view(ctx, given)
    pixels = view.draw()
    from slidectl.extensions.viewing import picture_files

    picture_files.write_png(path, pixels)
    (width, height), camera, time = given["size"], given["camera"], view.scene.time
    record = {
        "file": file, "width": width, "height": height, "time": time, "camera": camera,
        "robots": list(view.scene.robots), "drawn_by": view.drawer.name,
    }  # fmt: skip
    ctx.done(record, f"{file}: {width}x{height}, {camera}, at {time:.3f} s")


@command(
    examples=[
        "slidectl video slide.mp4 --for 30",
        "slidectl video slide.gif --for 5 --fps 20 --size 400x300 --camera side",
    ]
)
@click.argument("file", metavar="FILE", shell_complete=completion.files)
@click.option("--for", "seconds", type=float, callback=simulated_seconds, metavar="S",
              help="So much simulated time, s; else until Ctrl-C.")  # fmt: skip
@click.option("--fps", type=click.FloatRange(min=0.1), callback=finite, default=30.0, show_default=True, metavar="N",
              help="Pictures in a simulated second.")  # fmt: skip
@_looks
@click.pass_obj
def video(ctx: Context, /, file: str, seconds: float | None, fps: float, **given: Any) -> None:
    """Draw the world into a video.

    It is an .mp4 or a .gif, with exactly --fps pictures in a simulated second. A world that is paused is stepped, as
    fast as the pictures can be drawn, and is paused afterwards. One that runs goes on at its speed, and waits for a
    picture that takes longer: clients that go by simulated time see nothing of that. Views and drawing are those of
    'slidectl render'; a fixed view stays where it was at the beginning. At Ctrl-C, and when the daemon ends, the file
    is completed with the pictures that are there; the exit code is 130 and 3 then, and 0 at Ctrl-C without --for.

    JSON keys: file, width, height, pictures, fps, seconds (of the video), camera, drawn_by (OpenGL or software).
    """
    from slidectl.extensions.viewing.picture_files import VideoFile, check_video
    from slidectl.supervision import Interrupted, Interrupts

    rate = Fraction(fps).limit_denominator(1001)
    check_video(Path(file), given["size"], rate)
    total = None if seconds is None else max(1, round(Fraction(seconds) * rate))
    with suppress(Interrupted), Interrupts() as interrupts, interrupts.raised():
        view = _view(ctx, given)
        with ExitStack() as leaving:
            advance = leaving.enter_context(_time(ctx, rate))
            first = view.draw()
            with interrupts.held():
                out = VideoFile(Path(file), given["size"], rate)
                leaving.callback(_complete, ctx, out, view, given)
                out.add(first)
            show = leaving.enter_context(output.progress_bar(total, "pictures", not ctx.quiet))
            while not interrupts.received:
                show(out.count, "")
                advance(out.count)
                if out.count == total:
                    return
                pixels = view.draw()
                with interrupts.held():
                    out.add(pixels)
    if seconds is not None:
        raise click.exceptions.Exit(EXIT_INTERRUPTED)


def _view(ctx: Context, given: dict[str, Any]) -> WorldView:
    from slidectl.extensions.viewing.drawing import WorldView

    return WorldView(ctx.client, given["camera"], given["size"], given["software"], ctx.warn)


@contextmanager
def _time(ctx: Context, rate: Fraction) -> Iterator[Callable[[int], object]]:
    """Yield a function that advances the world to the picture with the given number; picture 0 is now."""
    client, status = ctx.client, ctx.call("/slidectl/status")
    step, now, is_told = Fraction(round(1e9 * status["timestep"]), 10**9), status["time"], False
    if rate * step > 1:
        raise UsageError(f"the world has {float(1 / step):g} cycles in a second, and --fps {float(rate):g} is more")

    def cycles(number: int) -> int:
        return round(number / (rate * step)) - round((number - 1) / (rate * step))

    def advance_by_steps(number: int) -> None:
        nonlocal now, is_told
        due, now = now + float(cycles(number) * step), client.step(cycles(number))
        if abs(now - due) > step / 2 and not is_told:
            ctx.warn(f"somebody else moved the world's time between two pictures, by {now - due:g} s")
            is_told = True

    if status["paused"]:
        yield advance_by_steps
        return
    with client.lockstep(float(cycles(1) * step), _HOLD_S) as lock:

        def advance(number: int) -> None:
            # The period is a whole number of cycles, the time between pictures need not be: each picture sets its own.
            client.call("/slidectl/lockstep", {"period": float(cycles(number) * step), "timeout": _HOLD_S})
            is_told = False
            while True:
                with suppress(TimedOut):
                    lock.step(_LOOK_S)
                    return
                if not is_told and (status := ctx.call("/slidectl/status"))["paused"]:
                    ctx.warn(pause_remark(status, "the video waits until it goes on"))
                    is_told = True

        yield advance


def _complete(ctx: Context, out: VideoFile, view: WorldView, given: dict[str, Any]) -> None:
    out.close()
    (width, height), camera = given["size"], given["camera"]
    record = {
        "file": str(out.path), "width": width, "height": height, "pictures": out.count, "fps": float(out.rate),
        "seconds": float(out.count / out.rate), "camera": camera, "drawn_by": view.drawer.name,
    }  # fmt: skip
    text = f"{out.path}: {output.count(out.count, 'picture')}, {record['seconds']:.3f} s, {width}x{height}, {camera}"
    ctx.done(record, text)
