"""`vergence train`: train gain schedules and policies."""

import os
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from vergence.commands.console import print_to_stderr
from vergence.commands.extras import require_modules
from vergence.commands.options import Flat, dated_run_folder, print_written
from vergence.commands.tables import print_table
from vergence.errors import ConfigurationError
from vergence.training.options import TrainOptions

if TYPE_CHECKING:
    from vergence.training.listener import TrainingResult
    from vergence.training.validation import ValidationScore


@dataclass(frozen=True, kw_only=True)
class Train:
    """Train a gain schedule or a policy; write a run folder from which training can resume."""

    options: Flat[TrainOptions] = field(default_factory=TrainOptions)
    out: Annotated[Path | None, tyro.conf.arg(help_behavior_hint="", metavar="PATH")] = None
    """Run folder, new or empty; runs/train-KIND-DATE-TIME by default."""
    resume: Annotated[Path | None, tyro.conf.arg(help_behavior_hint="", metavar="RUN")] = None
    """Resume the run in this folder, up to --steps or its original number of steps."""

    def run(self) -> int:
        """Run the command."""
        require_modules("train", "torch", "stable_baselines3", "tensorboard")
        from vergence.files import hold_lock
        from vergence.training.choices import resolve_config
        from vergence.training.run import resume, train

        if self.resume is not None:
            self._check_nothing_else()
            with hold_lock(self.resume), _watching(self.resume) as watch:
                return _end(resume(self.resume, watch, steps=self.options.steps))
        config, head = resolve_config(self.options)
        folder = self.out or dated_run_folder(f"train-{config.kind}")
        with hold_lock(folder), _watching(folder) as watch:
            return _end(train(folder, config, head, watch))

    def _check_nothing_else(self) -> None:
        """Refuse options other than --steps beside --resume."""
        unset = {**vars(TrainOptions()), "out": None, "steps": self.options.steps}
        for name, value in {**vars(self.options), "out": self.out}.items():
            if value != unset[name]:
                raise ConfigurationError(
                    f"{name}: expected nothing with --resume but --steps, got {value}"
                )


class _Watch:
    """Training progress: a bar with the latest evaluation on a terminal, lines elsewhere."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._console = Console(stderr=True, highlight=False)
        self.bar = Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            TextColumn("{task.fields[state]}"),
            TimeElapsedColumn(),
            TimeRemainingColumn(),
            console=self._console,
        )
        self._task = self.bar.add_task("training", total=None, state="")
        self._unit = ""
        self._baseline = ""
        self.stop = False

    def begin(self, baselines: "dict[str, ValidationScore]", unit: str) -> None:
        """See `TrainingListener.begin`."""
        self._unit = unit
        self._baseline = min(baselines, key=lambda name: baselines[name].headline)
        if self._console.is_terminal:
            self.bar.start()
        else:
            said = ", ".join(f"{name} {b.headline:.3f} {unit}" for name, b in baselines.items())
            print(f"{self._folder}: to beat on validation trials: {said}", file=sys.stderr)

    def resumed(self, done: int) -> None:
        """See `TrainingListener.resumed`."""
        print_to_stderr(
            f"goes on after {done} steps" if done else "nothing had been saved: begins at 0 steps"
        )

    def step(self, done: int, total: int) -> None:
        """See `TrainingListener.step`."""
        self.bar.update(self._task, completed=done, total=total)

    def row(self, row: dict[str, Any]) -> None:
        """See `TrainingListener.row`."""
        state = (
            f"{row['headline']:.3f} {self._unit}, {_compared(row['gain'], self._unit)} "
            f"than {self._baseline}, "
            f"{row['settled_fraction']:.1%} good, {row['steps_per_s']} steps/s"
        )
        self.bar.update(self._task, state=state)
        if not self._console.is_terminal:
            print(f"{row['step']} steps: {state}", file=sys.stderr, flush=True)

    def stopping(self) -> bool:
        """See `TrainingListener.stopping`."""
        return self.stop


@contextmanager
def _watching(folder: Path) -> Iterator[_Watch]:
    """Show progress; the first Ctrl-C stops and saves the run, the second ends it at once."""
    watch = _Watch(folder)

    def interrupt(_number: int, _frame: object) -> None:
        watch.stop = True
        signal.signal(signal.SIGINT, signal.default_int_handler)
        said = "interrupted: saving after this update (again to stop at once)"
        try:
            print_to_stderr(said)
        except RuntimeError:  # raised by a write to the stream that the signal interrupted
            os.write(2, f"vergence: {said}\n".encode())

    before = signal.signal(signal.SIGINT, interrupt)
    try:
        yield watch
    except KeyboardInterrupt:
        print_to_stderr(
            f"interrupted: vergence train --resume {folder} goes on from the last checkpoint"
        )
        raise SystemExit(130) from None
    finally:
        signal.signal(signal.SIGINT, before)
        if watch.bar.live.is_started:
            watch.bar.stop()


def _compared(gain: float, unit: str) -> str:
    """Comparison in words; `gain` is the reference's headline metric divided by ours."""
    better, worse = ("faster", "slower") if unit == "s" else ("nearer", "farther")
    if f"{gain:.2f}" == "1.00":
        return f"neither {better} nor {worse}"
    return f"{gain:.2f} times {better}" if gain > 1.0 else f"{1.0 / gain:.2f} times {worse}"


def _end(result: "TrainingResult") -> int:
    """Print the result of a run; return the exit code."""
    if not result.finished:
        print_to_stderr(
            f"stopped after {result.steps} steps: vergence train --resume {result.folder} goes on"
        )
        return 130
    baseline = min(result.baselines, key=lambda name: result.baselines[name].headline)
    reference = result.baselines[baseline].headline
    rows = [
        [
            name,
            f"{score.headline:z.3f}",
            f"{score.mean:z.3f}",
            f"{score.settled_fraction:.1%}",
            _compared(reference / score.headline, result.unit),
        ]
        for name, score in result.baselines.items()
    ]
    best = next(row for row in reversed(result.rows) if row["best"])
    rows += [
        [
            f"{name}, at {row['step']} steps",
            f"{row['headline']:z.3f}",
            f"{row['mean']:z.3f}",
            f"{row['settled_fraction']:.1%}",
            _compared(row["gain"], result.unit),
        ]
        for name, row in (("best", best), ("last", result.rows[-1]))
    ]
    print_table(
        ["controller", f"validation ({result.unit})", "mean", "good", f"than {baseline}"], rows
    )
    print_written(result.folder)
    return 0
