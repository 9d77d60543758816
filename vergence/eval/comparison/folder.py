"""The run folders of evaluations and margins: tables, figures, config.toml, section and report."""

import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, Protocol

import pandas as pd
import tomli_w
from matplotlib.figure import Figure

from vergence.errors import ConfigurationError
from vergence.eval.comparison.config import EvaluateConfig
from vergence.eval.comparison.evaluate import Evaluation
from vergence.eval.comparison.figures import evaluation_figures, figure_caption
from vergence.eval.comparison.tables import describe_evaluation, report_tables
from vergence.files import write_atomic
from vergence.models.head import HeadModel
from vergence.models.head_file import head_to_toml
from vergence.reporting.report import (
    SECTION_FILE,
    ReportSection,
    ReportTable,
    write_report,
    write_section,
)
from vergence.reporting.runs import package_versions, toml_value, write_json
from vergence.reporting.style import save_figure
from vergence.reporting.text import SectionText


class ControllerRun(Protocol):
    """Result of one controller in one scenario."""

    @property
    def scenario(self) -> str:
        """The scenario's name."""

    @property
    def controller(self) -> str:
        """The controller's label."""

    @property
    def head(self) -> HeadModel:
        """The head that the controller knew."""

    @property
    def options(self) -> dict[str, Any]:
        """The controller's options."""

    @property
    def tuned(self) -> bool | None:
        """True if the options were tuned for the head, see `ResolvedOptions`."""


def write_config_and_heads(
    folder: Path,
    config: EvaluateConfig,
    notes: list[str],
    failures: list[str],
    outcomes: Iterable[ControllerRun],
) -> None:
    """Write config.toml and a file for the head of each scenario."""
    heads: dict[str, Any] = {}
    ran: dict[str, dict[str, Any]] = {}
    tuned: dict[str, dict[str, bool]] = {}
    for one in outcomes:
        if one.scenario not in heads:
            file = f"head-{one.scenario}.toml"
            write_atomic(folder / file, head_to_toml(one.head))
            heads[one.scenario] = {"name": one.head.name, "digest": one.head.digest, "file": file}
        ran.setdefault(one.controller, {})[one.scenario] = toml_value(one.options)
        if one.tuned is not None:
            tuned.setdefault(one.controller, {})[one.scenario] = one.tuned
    content = {
        "config": toml_value(config.resolved()),
        "notes": notes,
        "failures": failures,
        "heads": heads,
        "controllers": ran,
        "tuned": tuned,
        "versions": package_versions(),
    }
    (folder / "config.toml").write_text(tomli_w.dumps(content), encoding="utf-8")


def write_run_report(
    folder: Path,
    *,
    name: str,
    title: str,
    text: SectionText,
    tables: list[ReportTable],
    figures: Mapping[str, Figure],
    captions: Mapping[str, str],
    data_file: str,
    data_row_count: int,
    config: EvaluateConfig,
    notes: list[str],
    failures: list[str],
    outcomes: Iterable[ControllerRun],
) -> None:
    """Write figures, configuration, section and report beside the tables of a run folder."""
    (folder / "figures").mkdir()
    for figure_name, figure in figures.items():
        save_figure(figure, folder / "figures" / figure_name)
    write_config_and_heads(folder, config, notes, failures, outcomes)
    section = ReportSection(
        name=name,
        title=title,
        article="",
        what=text.what,
        conclusion=text.found,
        summary=[],
        figures=[folder / "figures" / f"{figure_name}.svg" for figure_name in figures],
        rows=data_row_count,
        config=toml_value({**config.resolved(), "notes": notes, "failures": failures}),
        seed=config.seed,
        data=data_file,
        tables=tables,
        captions=dict(captions),
    )
    write_section(folder / SECTION_FILE, section)
    write_report(folder / "report.html", [section], title=title)


def write_evaluation(folder: Path, evaluation: Evaluation) -> None:
    """Write an evaluation's tables, figures, configuration and report into an empty folder."""
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
        title="Ways of looking at a target, compared",
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
