"""`vergence deploy`: run a policy on a robot, with checks, supervision and a log."""

import json
import sys
import threading
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import tyro
from rich.console import Console
from rich.live import Live
from rich.text import Text

from vergence import interrupts
from vergence.commands.checks import check_robot_and_print
from vergence.commands.console import print_to_stderr
from vergence.commands.extras import require_modules
from vergence.commands.gaze_rows import print_gazes
from vergence.commands.options import Flat, dated_run_folder
from vergence.eval.robot.config import DeployConfig

if TYPE_CHECKING:
    from vergence.eval.robot.deploy import GazeState

_TERMINAL_PERIOD_S: Final = 0.1
"""Time between two updates on a terminal, s (chosen: prompt against processor load)."""
_LINE_PERIOD_S: Final = 1.0
"""Time between two lines elsewhere, such as in a file, s (chosen: detail against length)."""


@dataclass(frozen=True, kw_only=True)
class Deploy:
    """Run a policy on a robot: check the robot, run gazes, log everything."""

    config: Flat[DeployConfig]
    log: Annotated[Path | None, tyro.conf.arg(help_behavior_hint="", metavar="PATH")] = None
    """Log to write, a new file (MCAP); runs/deploy-DATE-TIME.mcap by default."""
    json: bool = False
    """Print the result as JSON, and nothing else, on standard output."""

    def run(self) -> int:
        """Run the command."""
        require_modules("robot", "mcap")
        from vergence.eval.robot.deploy import deploy

        interrupts.raise_on_termination()
        log = self.log or dated_run_folder("deploy").with_suffix(".mcap")
        with _StatusPrinter(self.config) as status:
            result = deploy(self.config, log, check=check_robot_and_print, show=status.show)
        if self.json:
            print(json.dumps(result.summary(), indent=2, allow_nan=False))
        elif self.config.dry_run:
            print(f"dry run: nothing has moved\n{status.last()}")
        else:
            print_gazes(result.gazes.rows(), result.summary())
        if not self.json and result.expected is not None:
            print(result.expected)
        if not self.json:
            print(f"logged to {result.log} (vergence replay {result.log})")
        if result.error is not None and not self.config.dry_run:
            print_to_stderr(f"the same command with --resume {result.log} runs the missing gazes")
        if isinstance(result.error, KeyboardInterrupt):
            raise KeyboardInterrupt(f"{result.log} is written up to here")
        if result.error is not None:
            raise result.error
        return 0


class _StatusPrinter:
    """Status of the running gaze, printed by a thread so that no terminal delays the loop."""

    def __init__(self, config: DeployConfig) -> None:
        self._config = config
        self._present: GazeState | None = None
        self._last: dict[int, GazeState] = {}
        self._ended = threading.Event()
        self._console = Console(stderr=True, highlight=False)
        self._thread = threading.Thread(target=self._run, daemon=True, name="vergence line")

    def __enter__(self) -> "_StatusPrinter":
        self._thread.start()
        return self

    def __exit__(self, *exception: object) -> None:
        self._ended.set()
        self._thread.join(1.0)

    def show(self, present: "GazeState") -> None:
        """Store the present state; the thread prints it at its next update."""
        self._present = self._last[present.number] = present

    def last(self) -> str:
        """Last status of each gaze, a line each."""
        return "\n".join("  ".join(self._lines(present)) for present in self._last.values())

    def _run(self) -> None:
        if not self._console.is_terminal:
            while not self._ended.wait(_LINE_PERIOD_S):
                if self._present is not None:
                    print("  ".join(self._lines(self._present)), file=sys.stderr, flush=True)
            return
        with Live(console=self._console, auto_refresh=False, transient=True) as live:
            while not self._ended.wait(_TERMINAL_PERIOD_S):
                if self._present is not None:
                    live.update(Text("\n".join(self._lines(self._present))), refresh=True)

    def _lines(self, present: "GazeState") -> list[str]:
        from vergence.triangulation import triangulate_gaze, triangulate_views

        head, reading = present.head, present.reading
        fix, by = triangulate_gaze(head, reading.positions), ""
        if head.has_fixed_pair:  # its optical axes do not cross
            fix = triangulate_views(head, reading.positions_at_exposure, reading.pixels)
            by = " by ITPC"
        time_s = float(reading.time_s[0])
        rate_hz = present.step / time_s if time_s else float("nan")
        left, right = (float((eye @ eye) ** 0.5) for eye in present.pixel_error)
        lines = [
            f"gaze {present.number}/{self._config.gazes}  {time_s:.1f} s  "
            f"error {_number(left)} {_number(right)} px  {_number(rate_hz)} Hz  "
            f"{present.late_periods} late",
            f"gap {_number(1e3 * float(fix.gap[0]), 2)} mm  "
            f"point{by} {_three(1e3 * fix.point[0])} +- {_three(1e3 * fix.sigma[0])} mm",
        ]
        if self._config.dry_run:
            asked = zip(present.head.actuation.names, present.requested[3:], strict=False)
            speeds = ", ".join(f"{name} {value:+.2f}" for name, value in asked)
            lines.append(f"asked: {speeds} rad/s")
        return lines


def _number(value: float, decimals: int = 1) -> str:
    return "-" if value != value else f"{value:.{decimals}f}"


def _three(values: Any) -> str:
    return "(" + ", ".join(_number(float(value)) for value in values) + ")"
