"""The run folder of an evaluation, and its section in a report."""

import json
from pathlib import Path
from typing import Final

import pandas as pd

from vergence.errors import ConfigurationError
from vergence.eval.comparison.evaluation import Evaluation
from vergence.eval.comparison.figures import evaluation_figures, figure_caption
from vergence.eval.comparison.run_folder import write_run_report
from vergence.eval.comparison.tables import describe_evaluation, report_tables
from vergence.reporting.runs import write_json

TITLE: Final = "Ways of looking at a target, compared"


def write_evaluation(folder: Path, evaluation: Evaluation) -> None:
    """Write an evaluation's tables, figures, configuration and report.

    Args:
        folder: an empty folder, see `vergence.reporting.runs.run_folder`.
        evaluation: the evaluation.

    Raises:
        ConfigurationError: nothing was evaluated.
    """
    if not evaluation.outcomes:
        raise ConfigurationError("evaluation: expected at least one outcome, got none")
    rows = evaluation.rows()
    write_json(folder / "evaluation.json", rows)
    trials = evaluation.trials()
    trials.to_csv(folder / "trials.csv", index=False)
    summary = pd.DataFrame(
        [
            {**row, **{key: json.dumps(row.get(key, [])) for key in ("options", "given")}}
            for row in evaluation.summaries()
        ]
    )
    summary.to_csv(folder / "summary.csv", index=False)
    _long(evaluation, "curves").to_csv(folder / "curves.csv", index=False)
    _long(evaluation, "effective_gains").to_csv(folder / "gains.csv", index=False)
    figures = evaluation_figures(evaluation)
    write_run_report(
        folder,
        name="evaluation",
        title=TITLE,
        text=describe_evaluation(evaluation),
        tables=report_tables(evaluation),
        figures=figures,
        captions={name: figure_caption(name) for name in figures},
        data_file="trials.csv",
        data_row_count=len(trials),
        config=evaluation.config,
        notes=evaluation.notes,
        failures=evaluation.failures,
        outcomes=evaluation.outcomes,
    )


def _long(evaluation: Evaluation, what: str) -> pd.DataFrame:
    """Join the curves or gains of all outcomes, with columns for scenario, plant and controller."""
    parts = []
    for one in evaluation.outcomes:
        part: pd.DataFrame = getattr(one, what).copy()
        for place, name in enumerate(("scenario", "plant", "controller")):
            part.insert(place, name, getattr(one, name))
        parts.append(part)
    return pd.concat(parts, ignore_index=True)
