"""Checks of every experiment's table, summary and figures, for the tests."""

import json
import math
from pathlib import Path

from vergence.eval.article.experiment import load_experiment
from vergence.eval.article.reported import reported_results
from vergence.reporting.text import render_text


def unjudged(rows, experiment):
    """The article's results that a summary does not have with both ranges, unit and verdict."""
    ours = {
        (row.experiment, row.quantity, row.method, row.axis, row.article_low, row.article_high): row
        for row in rows
    }
    return [
        row
        for row in reported_results()
        if row.experiment == experiment
        and not _judged(
            ours.get((experiment, row.quantity, row.method, row.axis, row.low, row.high))
        )
    ]


def _judged(row):
    return (
        row is not None
        and math.isfinite(row.ours_low)
        and row.ours_low <= row.ours_high
        and row.verdict in {"reproduced", "same order", "differs", "by construction"}
    )


def section_text(experiment, table, config):
    return render_text(experiment.text, config=config, **experiment.numbers(table, config))


def full_run():
    docs = Path(__file__).resolve().parents[3] / "docs"
    return json.loads((docs / "results" / "reproduce.json").read_text(encoding="utf-8"))


def incomplete(name, table, config):
    """Names of figures without a caption or data, captions of none, and numbers no more in docs."""
    experiment = load_experiment(name)
    figures = experiment.draw(table, config)
    captions = section_text(experiment, table, config).captions
    empty = {
        drawn
        for drawn, figure in figures.items()
        for panel in figure.axes
        if not any(len(line.get_xdata()) > 1 for line in panel.lines)
        and not [*panel.containers, *panel.collections, *panel.images]
    }
    stale = set(experiment.numbers(table, config)) ^ set(full_run()[name])
    return sorted(empty | stale | (set(figures) ^ set(captions)))
