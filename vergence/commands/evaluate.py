"""`vergence evaluate`: controllers compared on the same trials."""

import sys
from contextlib import redirect_stdout
from dataclasses import dataclass, field, replace
from pathlib import Path
from textwrap import wrap
from typing import TYPE_CHECKING, Annotated

import tyro
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from vergence.commands.console import Bars, note
from vergence.commands.options import Flat, Machines, Tables, dated_folder, output
from vergence.commands.tables import print_cards
from vergence.eval.comparison.config import EvaluateConfig

if TYPE_CHECKING:
    from vergence.eval.comparison.evaluate import Evaluation
    from vergence.eval.reporting.report import ReportTable

_NAME_WIDTH = 18
_FILE_WIDTH = 120
"""Columns of the table where it goes to a file or a pipe."""


@dataclass(frozen=True, kw_only=True)
class Evaluate:
    """Compare controllers on the same trials; write tables, figures and a report."""

    config: Flat[EvaluateConfig] = field(default_factory=EvaluateConfig)
    out: Annotated[Path | None, tyro.conf.arg(metavar="PATH")] = None
    """Run folder, new or empty; runs/evaluate-DATE-TIME by default."""
    machines: Flat[Machines] = field(default_factory=Machines)
    tables: Flat[Tables] = field(default_factory=Tables)
    json: bool = False
    """Print the rows as JSON, and nothing else, on standard output."""

    def run(self) -> int:
        """Run the command."""
        self.tables.check()
        from vergence.eval.comparison.evaluate import evaluate, tune_first
        from vergence.eval.comparison.folder import write_evaluation

        def write(folder: Path) -> None:
            write_evaluation(folder, evaluation)
            self.tables.convert(*sorted(folder.glob("*.csv")))

        with output(self.out or dated_folder("evaluate")) as run:
            # what somebody's own code prints is no part of the result
            with redirect_stdout(sys.stderr), Bars() as bars, self.machines.open_mapper() as mapper:
                if self.config.tune:
                    mapper.progress = bars.begin("tune")
                    tune_first(self.config, mapper, say=note)
                mapper.progress = bars.begin("evaluate")
                evaluation = evaluate(self.config, mapper=mapper, keep_going=True)
            for text in evaluation.notes:
                note(text)
            run.conclude(write, evaluation.rows, lambda: _print(evaluation), as_json=self.json)
        # the others are not lost, and the exit code tells that not all were compared
        for text in evaluation.failures:
            note(f"error: {text}")
        return 0 if run.saved and not evaluation.failures else 2


def _print(evaluation: "Evaluation") -> None:
    from vergence.eval.comparison.tables import describe, legend, tables

    intervals = True
    console = Console(highlight=False)
    if not console.is_terminal:
        console = Console(highlight=False, width=_FILE_WIDTH)
    for found in tables(evaluation):
        fitting = (
            table
            for table in (_table(found, padding=2), _table(found, padding=0))
            if _width(table) <= console.width
        )
        table = next(fitting, None)
        if table is None:
            table = _table(_without_intervals(found), padding=0)
            intervals = False
        if _width(table) > console.width:
            print_cards(found.columns, found.rows, title=found.title, console=console)
            intervals = True
            continue
        console.print(table, markup=False, width=console.width)
    console.print(legend(evaluation, intervals=intervals), markup=False)
    console.print(describe(evaluation).found, markup=False)


def _table(found: "ReportTable", padding: int) -> Table:
    """A table whose columns are as wide as the longest word of their head or line of a cell."""
    table = Table(
        title=found.title, title_justify="left", box=SIMPLE_HEAD, pad_edge=False,
        padding=(0, padding, 0, 0),
    )  # fmt: skip
    rows = [[_wrapped(row[0]), *row[1:]] for row in found.rows]
    for place, column in enumerate(found.columns):
        words = [*column.split(), *(line for row in rows for line in row[place].splitlines())]
        table.add_column(column, justify="right" if place else "left", width=max(map(len, words)))
    for row in rows:
        table.add_row(*row)
    return table


def _width(table: Table) -> int:
    """Columns of the terminal that a table takes, its frame's edges included."""
    return 1 + sum((column.width or 0) + 1 + table.padding[1] for column in table.columns)


def _without_intervals(found: "ReportTable") -> "ReportTable":
    """A table without the second lines of its cells that are intervals."""
    rows = [
        [row[0], *(cell.split("\n")[0] if "–" in cell else cell for cell in row[1:])]
        for row in found.rows
    ]
    return replace(found, rows=rows)


def _wrapped(name: str) -> str:
    """A first cell whose second line, the options, is no wider than the longest names."""
    label, _, options = name.partition("\n")
    return "\n".join([label, *wrap(options, _NAME_WIDTH, break_long_words=False)])
