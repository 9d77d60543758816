"""`vergence detect --live`: detection statistics of a camera, updated each second."""

import json
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from typing import TYPE_CHECKING

from rich.console import Console, Group
from rich.live import Live
from rich.table import Table
from rich.text import Text

from vergence.commands.console import print_to_stderr
from vergence.reporting.text import format_fixed

if TYPE_CHECKING:
    from vergence.models.camera import CameraResponse
    from vergence.models.parts import FloatArray
    from vergence.perception.finding import LiveSummary
    from vergence.vision import Camera
    from vergence.vision.objects.targets import GazeTarget


def watch_camera(
    source: str,
    targets: "Sequence[GazeTarget]",
    camera: "Camera | None",
    seconds: float | None,
    *,
    camera_response: "CameraResponse | None",
    as_json: bool,
) -> int:
    """Watch until Ctrl-C, the end of a video or a time, s; exit code 1 if no target was found."""
    from vergence.perception.finding import LiveStatistics, make_live_finder, watch_targets
    from vergence.vision.image import is_local_camera, open_video

    statistics = LiveStatistics(targets)
    console = Console(stderr=True, highlight=False)
    shown: AbstractContextManager[Live | None] = nullcontext()
    if console.is_terminal:
        shown = Live(console=console, auto_refresh=False, transient=True)
    in_time = False
    try:
        with open_video(source) as images, shown as live:
            in_time = watch_targets(
                images,
                [make_live_finder(target, camera, camera_response) for target in targets],
                statistics,
                time.monotonic,
                time_limit_s=seconds,
                on_update=_show(live),
            )
    except KeyboardInterrupt:  # the usual way to end, not a failure
        if not statistics.run_summary().images:
            raise
        in_time = True
    state = statistics.run_summary()
    if is_local_camera(source) and not in_time:
        print_to_stderr(f"the images ended after {state.images}: is the camera still there?")
    if as_json:
        print(json.dumps({"source": source, **state.document()}, indent=2, allow_nan=False))
    else:
        Console(highlight=False).print(_picture(state, last=True))
    if not any(target.images_with_target for target in state.targets):
        print_to_stderr("error: expected a target in the images, found none")
        return 1
    return 0


def _show(live: Live | None) -> "Callable[[LiveSummary], None]":
    def show(state: "LiveSummary") -> None:
        if live is not None:
            live.update(_picture(state), refresh=True)
        else:
            print(_line(state), file=sys.stderr, flush=True)

    return show


def _line(state: "LiveSummary") -> str:
    """State in one line, for output that is no terminal."""
    seen = "; ".join(
        f"{one.target} {one.rate:.0%} at {_pixel(one.point_px, 2)} noise {_pixel(one.noise_px, 3)}"
        for one in state.targets
    )
    rate = format_fixed(state.frame_rate_hz, 1)
    return f"{state.seconds:.0f} s: {rate} images/s; {seen or 'nothing found'}"


def _picture(state: "LiveSummary", last: bool = False) -> Group:
    from vergence.perception.finding import WINDOW_S

    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0))
    missing = ("missing in",) if last else ()
    for column in ("target", "found", *missing, "u, v (px)", "noise (px)", "detector's sigma (px)"):
        table.add_column(column, justify="left" if column == "target" else "right")
    for one in state.targets:
        table.add_row(
            str(one.target),
            f"{one.rate:.0%}",
            *([f"{one.images - one.images_with_target} images"] if last else []),
            _pixel(one.point_px, 2),
            _pixel(one.noise_px, 3),
            _pixel(one.sigma_px, 3),
        )
    when = f"of all {state.images} images" if last else f"of the last {WINDOW_S:g} s"
    return Group(
        Text(
            f"{state.seconds:.1f} s, {state.images} images; "
            f"{format_fixed(state.frame_rate_hz, 1)} images a second, "
            f"{format_fixed(state.detection_ms, 1)} ms each to detect"
        ),
        Text(f"found, pixels and noise: {when}"),
        table,
        Text("" if last else "Ctrl-C ends"),
    )


def _pixel(values: "FloatArray", decimals: int) -> str:
    return ", ".join(format_fixed(float(value), decimals) for value in values)
