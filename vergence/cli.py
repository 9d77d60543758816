"""The command line: parses, calls, prints."""

import io
import json
import os
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stderr
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro
from rich.console import Console
from rich.progress import (
    BarColumn,
    Progress,
    TaskID,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.table import Table

from vergence._jit import kernels_are_cached
from vergence.errors import VergenceError

if TYPE_CHECKING:
    from vergence.eval.gaze import GazeResult
    from vergence.eval.report import Section

_PROGRESS_AFTER_S = 2.0


@dataclass(frozen=True, kw_only=True)
class Gaze:
    """Turn both eyes to a target and triangulate it; write a run folder."""

    head: str = "simulated"
    """Head: a preset's name (see `vergence info`) or the path of a TOML file."""
    target: Annotated[tuple[float, float, float], tyro.conf.arg(metavar="X Y Z")] = (
        0.0,
        -100.0,
        1000.0,
    )
    """Where the target stands, in mm, in the base frame N: x right, y down, z forward."""
    controller: str = "ibvs"
    """Controller that turns the eyes (see `vergence info`)."""
    gain: float = 4.0
    """Gain of the controller, 1/s."""
    plant: str = "rendered"
    """What moves and sees: rendered (drawn images and a detector), mujoco or kinematic."""
    out: Path | None = None
    """Run folder, new or empty; runs/gaze-DATE-TIME by default."""
    seed: int = 0
    """Seed of all noise."""
    duration: float = 2.0
    """Length of the trial, in seconds."""
    json: bool = False
    """Print the result as JSON, and nothing else, on standard output."""

    def run(self) -> int:
        """Run the command."""
        from vergence.eval.gaze import GazeConfig, run_gaze
        from vergence.eval.gaze_figure import draw_gaze
        from vergence.eval.runs import check_free, run_folder, write_config, write_json

        folder = self.out or Path("runs") / f"gaze-{datetime.now():%Y%m%d-%H%M%S-%f}"
        check_free(folder)
        config = GazeConfig(
            head=self.head,
            target_mm=self.target,
            controller=self.controller,
            gain=self.gain,
            plant=self.plant,
            seed=self.seed,
            duration_s=self.duration,
        )
        with _progress("gaze") as report:
            result = run_gaze(config, report)
        summary = result.summary()
        with run_folder(folder) as partial:
            write_json(partial / "result.json", summary)
            result.trajectory.to_parquet(partial / "trajectory.parquet")
            write_config(partial, config, result.head)
            draw_gaze(result, partial / "gaze.png")
        if self.json:
            print(json.dumps(summary, indent=2, allow_nan=False))
        else:
            _print_gaze(result, folder)
        return _verdict(result)


@dataclass(frozen=True, kw_only=True)
class Reproduce:
    """Run the article's experiments and report on them; finished ones are kept."""

    experiments: Annotated[tuple[str, ...], tyro.conf.Positional] = ()
    """Experiments (see `vergence info`); all by default."""
    out: Path | None = None
    """Run folder, new or of an earlier call; runs/reproduce (or -quick) by default."""
    seed: int = 0
    """Seed of all experiments."""
    quick: bool = False
    """Fewer points, heads and repetitions: a look in two minutes."""
    workers: int | None = None
    """Processes on this machine; one per processor by default."""
    cluster: str | None = None
    """Address of a Ray cluster to run on, HOST:PORT (needs the extra cluster)."""
    config: Path | None = None
    """TOML file with a table per experiment that changes its configuration."""
    set: Annotated[tuple[str, ...], tyro.conf.arg(metavar="EXPERIMENT.FIELD=VALUE")] = ()
    """Changes of configurations, over those of --config."""

    def run(self) -> int:
        """Run the command."""
        from vergence.envs.streams import as_seed
        from vergence.eval.reproduce import ReproduceConfig, read_overrides, reproduce

        out = self.out or Path("runs") / ("reproduce-quick" if self.quick else "reproduce")
        config = ReproduceConfig(
            experiments=self.experiments,
            out=out,
            seed=as_seed(self.seed),
            quick=self.quick,
            workers=self.workers or os.cpu_count() or 1,
            cluster=self.cluster,
            overrides=read_overrides(self.config, self.set),
        )
        with _Bars() as bars:
            try:
                sections = reproduce(config, bars)
            except KeyboardInterrupt:
                _note(f"interrupted: what is finished stays in {out}; call again to go on")
                return 130
        _print_summary(sections)
        print(f"written to {out / 'report.html'}")
        return 0


@dataclass(frozen=True, kw_only=True)
class Export:
    """Write the head as a MuJoCo model or a URDF, for use elsewhere."""

    format: Annotated[Literal["mjcf", "urdf"], tyro.conf.Positional]
    """File format."""
    head: str = "simulated"
    """Head: a preset's name or the path of a TOML file."""
    out: Path | None = None
    """Folder to write to, new or empty; export-FORMAT-HEAD by default."""

    def run(self) -> int:
        """Run the command."""
        from vergence.eval.runs import run_folder
        from vergence.models.export import export_files
        from vergence.models.head_file import load_head

        head = load_head(self.head)
        folder = self.out or Path(f"export-{self.format}-{head.name}")
        with run_folder(folder) as partial:
            for name, content in export_files(head, self.format).items():
                path = partial / name
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_bytes(content)
        for path in sorted(folder.rglob("*")):
            if path.is_file():
                print(path)
        return 0


@dataclass(frozen=True, kw_only=True)
class Info:
    """Show versions, presets, and which optional parts are there."""

    def run(self) -> int:
        """Run the command."""
        from vergence.controllers import CONTROLLERS
        from vergence.envs.plant import PLANTS
        from vergence.envs.targets import TARGETS
        from vergence.envs.views import opengl_works
        from vergence.eval.experiment import EXPERIMENTS
        from vergence.eval.runs import versions
        from vergence.models.head_file import load_head, presets

        console = Console(highlight=False)
        table = Table("package", "version", title="versions", title_justify="left")
        for package, version in versions().items():
            table.add_row(package, version)
        console.print(table)
        table = Table("head", "cameras", "loop", "digest", title="presets", title_justify="left")
        for name in presets():
            head = load_head(name)
            timing = head.timing
            table.add_row(
                name,
                f"{head.cameras.width} x {head.cameras.height}",
                f"{timing.control_rate_hz:g} Hz, images {1000 * timing.latency_s:.1f} ms old, "
                f"lag {1000 * timing.lag_s:g} ms",
                head.digest[:12],
            )
        console.print(table)
        table = Table("kind", "names", title="registries", title_justify="left")
        table.add_row("plants", ", ".join(PLANTS))
        table.add_row("controllers", ", ".join(CONTROLLERS))
        table.add_row("targets", ", ".join(TARGETS))
        table.add_row("environments", "vergence/Gaze-v0")
        table.add_row("experiments", ", ".join(EXPERIMENTS))
        console.print(table)
        table = Table("part", "state", title="optional parts", title_justify="left")
        found = versions(("pygame", "ray", "stable-baselines3", "torch"))
        for package, extra, use in (
            ("pygame", "render", "render_mode='human'"),
            ("ray", "cluster", "reproduce --cluster"),
            ("stable-baselines3", "train", "learning"),
            ("torch", "train", "learning"),
        ):
            state = found.get(package) or f"not installed: pip install 'vergence[{extra}]'"
            table.add_row(f"{package} ({use})", state)
        table.add_row(
            "OpenGL (view of the head in render())",
            "works" if opengl_works() else "not available: a schematic is drawn instead",
        )
        console.print(table)
        return 0


Command = (
    Annotated[Gaze, tyro.conf.subcommand("gaze")]
    | Annotated[Reproduce, tyro.conf.subcommand("reproduce")]
    | Annotated[Export, tyro.conf.subcommand("export")]
    | Annotated[Info, tyro.conf.subcommand("info")]
)


def main(arguments: list[str] | None = None) -> None:
    """Run the command line; exit code 0 for success, 1 for a gaze without a fix, 2 for misuse.

    Args:
        arguments: the words after the program's name; None for those of the process.
    """
    command = _parse(arguments)
    if not kernels_are_cached():
        _note("compiling kernels, once after installation (about 20 s)")
    try:
        code = command.run()
    except VergenceError as error:
        _note(f"error: {error}")
        code = 2
    except BrokenPipeError:
        # the reader of a pipe has gone: nothing is left to say, not even at exit
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        code = 0
    except KeyboardInterrupt:
        _note("interrupted: nothing was written")
        code = 130
    sys.exit(code)


def _parse(arguments: list[str] | None) -> Any:
    """The command that the words ask for; words that make none end in one line on stderr."""
    said = io.StringIO()
    try:
        with redirect_stderr(said):
            return tyro.cli(
                Command,
                prog="vergence",
                description="Active binocular vision for robot heads.",
                args=arguments,
            )
    except SystemExit as stop:
        if stop.code == 2:
            _note(f"error: {_first_statement(said.getvalue())} (see vergence --help)")
        raise


def _first_statement(box: str) -> str:
    """What tyro says first in its frame, which goes on with help that --help shows as well."""
    lines = [line.strip("│╭╮╰╯ ") for line in box.splitlines()]
    inside = [line for line in lines[1:] if line]
    end = next((i for i, line in enumerate(inside) if not line.strip("─")), len(inside))
    return " ".join(inside[:end]) or " ".join(lines)


def _note(text: str) -> None:
    print(f"vergence: {text}", file=sys.stderr)


@contextmanager
def _progress(what: str) -> Iterator[Callable[[float], None]]:
    """A progress bar on standard error, from two seconds on and only on a terminal."""
    console = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), TimeRemainingColumn())
    bar = Progress(*columns, console=console, transient=True)
    task = bar.add_task(what, total=1.0)
    begun = time.monotonic()
    shown = False

    def report(fraction: float) -> None:
        nonlocal shown
        if not shown and console.is_terminal and time.monotonic() - begun > _PROGRESS_AFTER_S:
            bar.start()
            shown = True
        bar.update(task, completed=fraction)

    try:
        yield report
    finally:
        if shown:
            bar.stop()


class _Bars:
    """A progress bar for each experiment on a terminal, a line for each elsewhere."""

    def __init__(self) -> None:
        columns = (
            TextColumn("{task.description:<18}"),
            BarColumn(),
            TimeElapsedColumn(),
            TextColumn("{task.fields[state]}"),
        )
        self._console = Console(stderr=True)
        self._bars = Progress(*columns, console=self._console)
        self._tasks: dict[str, TaskID] = {}

    def __enter__(self) -> "_Bars":
        if self._console.is_terminal:
            self._bars.start()
        return self

    def __exit__(self, *exception: object) -> None:
        if self._console.is_terminal:
            self._bars.stop()

    def begin(self, name: str) -> Callable[[int, int], None]:
        """See `Listener.begin`."""
        task = self._tasks[name] = self._bars.add_task(name, total=None, state="")

        def report(done: int, total: int) -> None:
            # an experiment may map several rounds of jobs: the bar shows the present one
            self._bars.update(task, completed=done, total=total, state=f"{done} of {total}")

        return report

    def end(self, name: str, seconds: float | None) -> None:
        """See `Listener.end`."""
        state = "kept from an earlier call" if seconds is None else f"{seconds:.1f} s"
        self._bars.update(self._tasks[name], completed=1, total=1, state=state)
        if not self._console.is_terminal:
            print(f"{name}: {state}", file=sys.stderr, flush=True)


def _print_summary(sections: "list[Section]") -> None:
    from vergence.eval.report import format_range, headlines

    console = Console(highlight=False)
    table = Table("result", "the article", "ours", "verdict")
    judged = [row for _name, row in headlines(sections)]
    for row in judged:
        what = f"{row['experiment']}, {row['quantity']}, {row['method']}, {row['axis']}"
        table.add_row(
            what,
            f"{format_range(row['article_low'], row['article_high'])} {row['unit']}",
            f"{format_range(row['ours_low'], row['ours_high'])} {row['unit']}",
            row["verdict"],
        )
    console.print(table)
    others = sum(len(section.summary) for section in sections) - len(judged)
    if others:
        console.print(f"{others} more results are in the report")


def _print_gaze(result: "GazeResult", folder: Path) -> None:
    console = Console(highlight=False)
    console.print(
        f"settled to 1 px after {_seconds(result.settle_1px_s)}, "
        f"to 0.5 px after {_seconds(result.settle_05px_s)}"
    )
    table = Table("", "x (mm)", "y (mm)", "z (mm)", "common perpendicular (mm)")
    for column in table.columns[1:]:
        column.justify = "right"
    table.add_row("truth", *(f"{1e3 * v:.3f}" for v in result.truth_m), "")
    for name, fix in (("gaze", result.gaze), ("ITPC", result.itpc)):
        point, sigma = 1e3 * fix.point[0], 1e3 * fix.sigma[0]
        error = point - 1e3 * result.truth_m
        table.add_section()
        table.add_row(name, *(f"{v:.3f}" for v in point), f"{1e3 * fix.gap[0]:.4f}")
        table.add_row("  1 sigma", *(f"{v:.3f}" for v in sigma), "")
        table.add_row("  error", *(f"{v:+.3f}" for v in error), "")
    console.print(table)
    console.print(f"written to {folder}")


def _seconds(value: float) -> str:
    return f"{value:.3f} s" if value == value else "- (never)"


def _verdict(result: "GazeResult") -> int:
    """Exit code: what has no answer is an error here, though everything is written."""
    for name, fix in (("gaze", result.gaze), ("ITPC", result.itpc)):
        if not fix.valid[0]:
            _note(
                f"error: {name} found no point: expected two rays that cross in front of both "
                "eyes, got near-parallel rays, a crossing behind them, or an eye without the target"
            )
            return 1
    if result.settle_1px_s != result.settle_1px_s:
        _note("error: the eyes did not settle to 1 px within the trial")
        return 1
    return 0
