"""`vergence reproduce`: rerun the article's experiments and compare the results."""

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from rich.console import Console

from vergence.commands.console import ExperimentProgress
from vergence.commands.options import Flat, JobOptions, TableOptions
from vergence.commands.tables import print_table
from vergence.eval.article.config import ReproduceConfig

if TYPE_CHECKING:
    from vergence.reporting.report import ReportSection


@dataclass(frozen=True, kw_only=True)
class Reproduce:
    """Run the article's experiments and report the results; finished experiments are kept."""

    config: Flat[ReproduceConfig] = field(default_factory=ReproduceConfig)
    machines: Flat[JobOptions] = field(default_factory=JobOptions)
    tables: Flat[TableOptions] = field(default_factory=TableOptions)

    def run(self) -> int:
        """Run the command."""
        self.tables.check()
        from vergence.eval.article.reproduce import reproduce

        folder = self.config.folder
        try:
            with self.machines.open_mapper() as mapper, ExperimentProgress() as bars:
                sections = reproduce(self.config, bars, mapper)
            self.tables.convert(*sorted((folder / "tables").glob("*.csv")))
            _print_summary(sections)
            print(f"written to {folder / 'report.html'}")
        except KeyboardInterrupt:
            if not folder.is_dir():
                raise
            raise KeyboardInterrupt(
                f"what is finished stays in {folder}; call again to go on"
            ) from None
        return 0


def _print_summary(sections: "list[ReportSection]") -> None:
    from vergence.eval.article.criterion import (
        REPRODUCED,
        VERDICTS,
        article_summary_rows,
        count_verdicts,
    )
    from vergence.reporting.text import METHODS_LEGEND, format_range

    judged = [row for _name, row in article_summary_rows(sections)]
    rows = [
        [
            f"{row['experiment']}, {row['quantity']}, {row['method']}, {row['axis']}".replace(
                "itpc", "ITPC"
            ),
            f"{format_range(row['article_low'], row['article_high'])} {row['unit']}",
            f"{format_range(row['ours_low'], row['ours_high'])} {row['unit']}",
            row["verdict"],
        ]
        for row in judged
    ]
    console = Console(highlight=False)
    if rows:
        print_table(["result", "the article", "ours", "verdict"], rows, wrapped=(0, 3))
        counts = count_verdicts(sections)
        console.print(
            f"{counts.get(REPRODUCED, 0)} of {len(judged)} results reproduced: "
            f"{VERDICTS[REPRODUCED]}"
        )
        console.print(METHODS_LEGEND)
    others = sum(len(section.summary) for section in sections) - len(judged)
    if others:
        console.print(f"{others} more results are in the report")
    if any(section.quick for section in sections):
        console.print("a quick run: fewer points, heads and repetitions; verdicts may differ")
