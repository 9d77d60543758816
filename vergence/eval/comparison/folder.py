"""The run folder of an evaluation, and its section in a report."""

import json
from pathlib import Path
from typing import Final

import pandas as pd

from vergence.errors import ConfigurationError
from vergence.eval.comparison.evaluation import Evaluation
from vergence.eval.comparison.figures import caption, draw
from vergence.eval.comparison.ran import what_ran, write_ran
from vergence.eval.comparison.tables import describe, tables
from vergence.eval.reporting.report import Section, write_report
from vergence.eval.reporting.runs import write_json
from vergence.eval.reporting.section import SECTION_FILE, write_section
from vergence.eval.reporting.style import save_figure

TITLE: Final = "Ways of looking at a target, compared"


def write_evaluation(folder: Path, evaluation: Evaluation) -> None:
    """Write an evaluation's tables, figures, configuration and report.

    Args:
        folder: an empty folder, see `vergence.eval.reporting.runs.run_folder`.
        evaluation: what to write.

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
    _long(evaluation, "gains").to_csv(folder / "gains.csv", index=False)
    (folder / "figures").mkdir()
    figures = draw(evaluation)
    for name, figure in figures.items():
        save_figure(figure, folder / "figures" / name)
    ran = evaluation.config, evaluation.notes, evaluation.failures
    write_ran(folder, *ran, evaluation.outcomes)
    text = describe(evaluation)
    section = Section(
        name="evaluation",
        title=TITLE,
        article="",
        what=text.what,
        conclusion=text.found,
        summary=[],
        figures=[folder / "figures" / f"{name}.svg" for name in figures],
        rows=len(trials),
        config=what_ran(*ran),
        seed=evaluation.config.seed,
        data="trials.csv",
        tables=tables(evaluation),
        captions={name: caption(name) for name in figures},
    )
    write_section(folder / SECTION_FILE, section)
    write_report(folder / "report.html", [section], title=TITLE)


def _long(evaluation: Evaluation, what: str) -> pd.DataFrame:
    """The curves or the gains of all outcomes, each row named by its controller."""
    parts = []
    for one in evaluation.outcomes:
        part: pd.DataFrame = getattr(one, what).copy()
        for place, name in enumerate(("scenario", "plant", "controller")):
            part.insert(place, name, getattr(one, name))
        parts.append(part)
    return pd.concat(parts, ignore_index=True)
