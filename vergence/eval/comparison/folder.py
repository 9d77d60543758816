"""The run folder of an evaluation, and its section in a report."""

import dataclasses
import json
from pathlib import Path
from typing import Any, Final

import pandas as pd
import tomli_w

from vergence.errors import ConfigurationError
from vergence.eval.comparison.evaluation import Evaluation
from vergence.eval.comparison.figures import caption, draw
from vergence.eval.comparison.tables import describe, tables
from vergence.eval.reporting.report import Section, write_report
from vergence.eval.reporting.runs import plain, versions, write_json
from vergence.eval.reporting.section import SECTION_FILE, write_section
from vergence.eval.reporting.style import save_figure
from vergence.models.files.head_file import save_head

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
    _write_config(folder, evaluation)
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
        config=plain(
            {
                **dataclasses.asdict(evaluation.config),
                "notes": evaluation.notes,
                "failures": evaluation.failures,
            }
        ),
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


def _write_config(folder: Path, evaluation: Evaluation) -> None:
    heads: dict[str, Any] = {}
    ran: dict[str, dict[str, Any]] = {}
    tuned: dict[str, dict[str, bool]] = {}
    for one in evaluation.outcomes:
        if one.scenario not in heads:
            file = f"head-{one.scenario}.toml"
            save_head(one.head, folder / file)
            heads[one.scenario] = {"name": one.head.name, "digest": one.head.digest, "file": file}
        ran.setdefault(one.controller, {})[one.scenario] = plain(one.options)
        if one.tuned is not None:
            tuned.setdefault(one.controller, {})[one.scenario] = one.tuned
    content = {
        "config": plain(dataclasses.asdict(evaluation.config)),
        "notes": evaluation.notes,
        "failures": evaluation.failures,
        "heads": heads,
        "controllers": ran,
        "tuned": tuned,
        "versions": versions(),
    }
    (folder / "config.toml").write_text(tomli_w.dumps(content), encoding="utf-8")
