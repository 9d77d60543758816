"""`vergence reproduce`: the article's experiments, its figures beside ours."""

import os
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro
from rich.console import Console
from rich.table import Table

from vergence.commands.console import Bars, note

if TYPE_CHECKING:
    from vergence.eval.reporting.report import Section


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
    include: tuple[Path, ...] = ()
    """Run folders of vergence evaluate to show in the report, after the experiments."""

    def run(self) -> int:
        """Run the command."""
        from vergence.envs.streams import as_seed
        from vergence.eval.article.overrides import read_overrides
        from vergence.eval.article.reproduce import ReproduceConfig, reproduce

        out = self.out or Path("runs") / ("reproduce-quick" if self.quick else "reproduce")
        config = ReproduceConfig(
            experiments=self.experiments,
            out=out,
            seed=as_seed(self.seed),
            quick=self.quick,
            workers=self.workers or os.cpu_count() or 1,
            cluster=self.cluster,
            overrides=read_overrides(self.config, self.set),
            include=self.include,
        )
        with Bars() as bars:
            try:
                sections = reproduce(config, bars)
            except KeyboardInterrupt:
                note(f"interrupted: what is finished stays in {out}; call again to go on")
                return 130
        _print_summary(sections)
        print(f"written to {out / 'report.html'}")
        return 0


def _print_summary(sections: "list[Section]") -> None:
    from vergence.eval.reporting.report import headlines
    from vergence.eval.reporting.text import format_range

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
