"""The run folder of margins, and their section in a report."""

from pathlib import Path
from typing import Final

import pandas as pd

from vergence.errors import ConfigurationError
from vergence.eval.comparison.ran import what_ran, write_ran
from vergence.eval.margins.figure import draw
from vergence.eval.margins.margins import Margins
from vergence.eval.margins.tables import describe, tables
from vergence.eval.reporting.report import Section, write_report
from vergence.eval.reporting.runs import write_json
from vergence.eval.reporting.section import SECTION_FILE, write_section
from vergence.eval.reporting.style import save_figure

TITLE: Final = "How far a loop may be from its model"


def write_margins(folder: Path, margins: Margins) -> None:
    """Write the tables, figures, configuration and report of margins.

    Args:
        folder: an empty folder, see `vergence.eval.reporting.runs.run_folder`.
        margins: what to write.

    Raises:
        ConfigurationError: nothing was found.
    """
    if not margins.found:
        raise ConfigurationError("margins: expected at least one, got none")
    write_json(folder / "margins.json", margins.rows())
    _ranges(margins).to_csv(folder / "margins.csv", index=False)
    _points(margins).to_csv(folder / "points.csv", index=False)
    (folder / "figures").mkdir()
    figures = draw(margins)
    for name, figure in figures.items():
        save_figure(figure, folder / "figures" / name)
    ran = margins.config, margins.notes, margins.failures
    write_ran(folder, *ran, margins.found)
    text = describe(margins)
    section = Section(
        name="margins",
        title=TITLE,
        article="",
        what=text.what,
        conclusion=text.found,
        summary=[],
        figures=[folder / "figures" / f"{name}.svg" for name in figures],
        rows=len(margins.found),
        config=what_ran(*ran),
        seed=margins.config.seed,
        data="margins.csv",
        tables=tables(margins),
        captions=dict.fromkeys(figures, text.captions["margins"]),
    )
    write_section(folder / SECTION_FILE, section)
    write_report(folder / "report.html", [section], title=TITLE)


def _ranges(margins: Margins) -> pd.DataFrame:
    """The rows of margins.json with what was searched."""
    return pd.DataFrame(
        [
            {
                **one.row(),
                "expected": one.range.expected,
                "searched_low": one.range.low,
                "searched_high": one.range.high,
            }
            for one in margins.found
        ]
    )


def _points(margins: Margins) -> pd.DataFrame:
    """All that was measured: a row for each value."""
    return pd.DataFrame(
        [
            {
                "controller": one.controller,
                "scenario": one.scenario,
                "imperfection": one.imperfection,
                "unit": one.unit,
                **point._asdict(),
            }
            for one in margins.found
            for point in one.points
        ]
    )
