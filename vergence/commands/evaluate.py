"""`vergence evaluate`: compare controllers on the same trials, or measure their margins."""

import json
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stdout
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from shutil import rmtree
from textwrap import wrap
from typing import TYPE_CHECKING, Annotated, Any, Final, NamedTuple

from rich.box import SIMPLE_HEAD
from rich.console import Console, JustifyMethod
from rich.table import Table
from tyro.conf import arg

from vergence import interrupts
from vergence.commands.checks import check_robot_and_print
from vergence.commands.console import ExperimentProgress, print_to_stderr
from vergence.commands.extras import require_modules
from vergence.commands.options import (
    Flat,
    JobOptions,
    TableOptions,
    claimed_run_folder,
    dated_run_folder,
    print_written,
)
from vergence.commands.tables import print_table
from vergence.errors import ConfigurationError, VergenceError
from vergence.eval.comparison.config import EvaluateConfig

if TYPE_CHECKING:
    from vergence.eval.comparison.evaluate import Evaluation
    from vergence.eval.margins.run import Margins
    from vergence.reporting.jobs import Mapper
    from vergence.reporting.report import ReportTable

_NAME_WIDTH: Final = 18
"""Width to which the options below a name are wrapped, characters (chosen: that of long names)."""
_FILE_WIDTH: Final = 120
"""Width of tables that go to a file or a pipe, characters (chosen: whole rows against
narrow pages)."""
_LEGEND_HINT: Final = "--legend explains every column."


@dataclass(frozen=True, kw_only=True)
class Evaluate:
    """Compare controllers on the same trials; write tables, figures and a report."""

    config: Flat[EvaluateConfig] = field(default_factory=EvaluateConfig)
    out: Annotated[Path | None, arg(help_behavior_hint="", metavar="PATH")] = None
    """Run folder, new or empty; runs/evaluate-DATE-TIME by default, runs/margins-DATE-TIME with
    --margins."""
    resume: Annotated[Path | None, arg(help_behavior_hint="", metavar="RUN")] = None
    """Run the trials on a robot that are missing in this run folder."""
    machines: Flat[JobOptions] = field(default_factory=JobOptions)
    tables: Flat[TableOptions] = field(default_factory=TableOptions)
    json: bool = False
    """Print the rows as JSON, and nothing else, on standard output."""
    legend: bool = False
    """Explain every column below the table."""
    margins: bool = False
    """Vary one imperfection of the loop at a time, and find the range of its values in which 99 %
    of the trials still settle and the median settling time is less than doubled."""
    imperfections: Annotated[
        tuple[str, ...], arg(help_behavior_hint="", name="imperfection", metavar="NAME...")
    ] = ()
    """With --margins: the imperfections to vary, such as command_latency_s; all by default."""

    def run(self) -> int:
        """Run the command."""
        self.tables.check()
        if self.imperfections and not self.margins:
            raise ConfigurationError(
                f"imperfection: expected none without --margins, got {self.imperfections[0]}"
            )
        if self.resume is not None or self.config.on_robot:
            return self._on_robot()
        from vergence.eval.comparison.lineup import tune_baselines

        with claimed_run_folder(
            self.out or dated_run_folder("margins" if self.margins else "evaluate")
        ) as run:
            # output of a user's own code must not mix with the result
            with (
                redirect_stdout(sys.stderr),
                ExperimentProgress() as bars,
                self.machines.open_mapper() as mapper,
            ):
                if self.config.tune:
                    mapper.progress = bars.begin("tune")
                    tune_baselines(self.config, mapper, report=print_to_stderr)
                mapper.progress = bars.begin("margins" if self.margins else "evaluate")
                result = self._margins(mapper) if self.margins else self._evaluation(mapper)
            for text in result.notes:
                print_to_stderr(text)
            run.finish(partial(self._write, result), result.rows, result.show, as_json=self.json)
        # the other results are kept, and the exit code reports that some failed
        for text in result.failures:
            print_to_stderr(f"error: {text}")
        return 0 if run.saved and not result.failures else 2

    def _on_robot(self) -> int:
        """Run trials on a robot, or only the missing ones, and write the results of all."""
        require_modules("robot", "mcap")
        from vergence.eval.robot.evaluate import evaluate_on_robot, read_begun_config
        from vergence.files import atomic_files, hold_lock
        from vergence.reporting.runs import check_writable

        self._check_robot()
        interrupts.raise_on_termination()
        run, config = self.resume or self.out or dated_run_folder("evaluate"), self.config
        if self.resume is None:
            check_writable(run)
        else:
            config = read_begun_config(run)
        with hold_lock(run), _kept(run):
            with (
                redirect_stdout(sys.stderr),
                ExperimentProgress() as bars,
                self.machines.open_mapper() as mapper,
            ):
                mapper.progress = bars.begin("evaluate")
                found = evaluate_on_robot(
                    config, run, mapper, bars.begin("robot"), resume=self.resume is not None,
                    check=check_robot_and_print, keep_going=True,
                )  # fmt: skip
            for text in found.notes:
                print_to_stderr(text)
            result = _as_result(found, self.legend)
            with atomic_files(run, moved_last="evaluation.json") as folder:
                self._write(result, folder)
                rmtree(run / "figures", ignore_errors=True)  # of an earlier evaluation of this run
        if self.json:
            print(json.dumps(result.rows(), indent=2, allow_nan=False))
        else:
            result.show()
            print_written(run)
        for text in result.failures:
            print_to_stderr(f"error: {text}")
        return 2 if result.failures else 0

    def _check_robot(self) -> None:
        """Refuse options that cannot be combined with trials on a robot."""
        others = {"out": self.out, "margins": self.margins or None}
        if self.resume is not None:
            unset = vars(EvaluateConfig())
            others |= {k: v for k, v in vars(self.config).items() if v != unset[k]}
        else:
            others.pop("out")
        for name, value in others.items():
            if value is not None:
                beside = "--plant hardware" if self.resume is None else "--resume"
                raise ConfigurationError(f"{name}: expected none with {beside}, got {value}")

    def _write(self, result: "_Result", folder: Path) -> None:
        result.write(folder)
        self.tables.convert(*sorted(folder.glob("*.csv")))

    def _evaluation(self, mapper: "Mapper") -> "_Result":
        from vergence.eval.comparison.evaluate import evaluate

        return _as_result(evaluate(self.config, mapper=mapper, keep_going=True), self.legend)

    def _margins(self, mapper: "Mapper") -> "_Result":
        from vergence.eval.margins.report import write_margins
        from vergence.eval.margins.run import MarginsConfig, measure_margins

        config = MarginsConfig(**vars(self.config), imperfections=self.imperfections)
        found = measure_margins(config, mapper=mapper, keep_going=True)
        return _Result(
            found.notes, found.failures, found.rows, lambda: _print_margins(found, self.legend),
            lambda folder: write_margins(folder, found),
        )  # fmt: skip


class _Result(NamedTuple):
    """Result of an evaluation or of margins, behind one interface."""

    notes: list[str]
    failures: list[str]
    rows: Callable[[], list[dict[str, Any]]]
    show: Callable[[], None]
    write: Callable[[Path], None]


def _as_result(evaluation: "Evaluation", legend: bool) -> _Result:
    from vergence.eval.comparison.folder import write_evaluation

    return _Result(
        evaluation.notes, evaluation.failures, evaluation.rows, lambda: _print(evaluation, legend),
        lambda folder: write_evaluation(folder, evaluation),
    )  # fmt: skip


@contextmanager
def _kept(run: Path) -> Iterator[None]:
    """Report the kept trials and the command that continues, if the body is interrupted."""
    from vergence.eval.robot.evaluation_record import EvaluationRecord

    how = f"vergence evaluate --resume {run} goes on"

    def kept() -> str:
        try:
            count = EvaluationRecord(run).count()
        except ConfigurationError:
            return ""
        return f"trials kept in {run}: {count}; {how}" if count else ""

    try:
        yield
    except KeyboardInterrupt as stop:
        raise KeyboardInterrupt(kept()) if kept() else stop from None
    except VergenceError:
        if kept():
            print_to_stderr(kept())
        raise


def _print_margins(margins: "Margins", legend: bool) -> None:
    from vergence.eval.margins.report import LEGEND, report_tables

    console = _console()
    for found in report_tables(margins):
        print_table(found.columns, found.rows, title=found.title, console=console)
        console.print()
    console.print(LEGEND if legend else _LEGEND_HINT, markup=False)


def _console() -> Console:
    """Console of the width of the terminal or of COLUMNS; wide for a file or a pipe."""
    console = Console(highlight=False)
    known = console.is_terminal or "COLUMNS" in os.environ
    return console if known else Console(highlight=False, width=_FILE_WIDTH)


def _print(evaluation: "Evaluation", legend: bool) -> None:
    from vergence.eval.comparison.evaluate import laws_for_loop
    from vergence.eval.comparison.tables import (
        describe_evaluation,
        report_tables,
        table_hint,
        table_legend,
    )

    console = _console()
    for found in report_tables(evaluation):
        console.print(found.title, markup=False)
        for table in _tables(found, console.width):
            console.print(table, markup=False, width=console.width)
    text = table_legend(evaluation) if legend else f"{table_hint(evaluation)} {_LEGEND_HINT}"
    console.print(text, markup=False)
    console.print(describe_evaluation(evaluation).found, markup=False)
    for line in laws_for_loop(evaluation):
        console.print(line, markup=False)


def _tables(found: "ReportTable", width: int) -> Iterator[Table]:
    """Tables that fit a width and have all columns together, each with the names of the rows."""
    names, *columns = (
        [head, *cells] for head, *cells in zip(found.columns, *found.rows, strict=True)
    )
    names[1:] = map(_wrapped, names[1:])
    while columns:
        table = Table(box=SIMPLE_HEAD, pad_edge=False, padding=(0, 1, 0, 0))
        shown = [names, columns.pop(0)]
        while columns and 1 + sum(_width(one) + 2 for one in (*shown, columns[0])) <= width:
            shown.append(columns.pop(0))
        for column in shown:
            justify: JustifyMethod = "left" if column is names else "right"
            table.add_column(column[0], justify=justify, width=_width(column))
        for cells in zip(*(column[1:] for column in shown), strict=True):
            table.add_row(*cells)
        yield table
        names = [name.split("\n")[0] for name in names]  # options once are enough


def _width(column: list[str]) -> int:
    """Width of the longest word of a heading or line of a cell."""
    head, *cells = column
    return max(map(len, [*head.split(), *(line for cell in cells for line in cell.splitlines())]))


def _wrapped(name: str) -> str:
    """First cell with its second line, the options, wrapped to the width of long names."""
    label, _, options = name.partition("\n")
    return "\n".join([label, *wrap(options, _NAME_WIDTH, break_long_words=False)])
