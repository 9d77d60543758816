"""The run folder of margins, and their section in a report."""

from pathlib import Path
from typing import Final

import pandas as pd

from vergence.errors import ConfigurationError
from vergence.eval.comparison.run_folder import write_run_report
from vergence.eval.margins.figure import margin_figures
from vergence.eval.margins.margins import Margins
from vergence.eval.margins.tables import describe_margins, report_tables
from vergence.reporting.runs import write_json

TITLE: Final = "How far a loop may be from its model"


def write_margins(folder: Path, margins: Margins) -> None:
    """Write the tables, figures, configuration and report of margins.

    Args:
        folder: an empty folder, see `vergence.reporting.runs.run_folder`.
        margins: the margins.

    Raises:
        ConfigurationError: there are no margins.
    """
    if not margins.margins:
        raise ConfigurationError("margins: expected at least one, got none")
    write_json(folder / "margins.json", margins.rows())
    _ranges(margins).to_csv(folder / "margins.csv", index=False)
    _points(margins).to_csv(folder / "points.csv", index=False)
    figures, text = margin_figures(margins), describe_margins(margins)
    write_run_report(
        folder,
        name="margins",
        title=TITLE,
        text=text,
        tables=report_tables(margins),
        figures=figures,
        captions=dict.fromkeys(figures, text.captions["margins"]),
        data_file="margins.csv",
        data_row_count=len(margins.margins),
        config=margins.config,
        notes=margins.notes,
        failures=margins.failures,
        outcomes=margins.margins,
    )


def _ranges(margins: Margins) -> pd.DataFrame:
    """The rows of margins.json with the expected value and the searched range."""
    return pd.DataFrame(
        [
            {
                **one.row(),
                "expected": one.range.expected,
                "searched_low": one.range.low,
                "searched_high": one.range.high,
            }
            for one in margins.margins
        ]
    )


def _points(margins: Margins) -> pd.DataFrame:
    """All measurements: one row per value of an imperfection."""
    return pd.DataFrame(
        [
            {
                "controller": one.controller,
                "scenario": one.scenario,
                "imperfection": one.imperfection,
                "unit": one.unit,
                **point._asdict(),
            }
            for one in margins.margins
            for point in one.points
        ]
    )
