"""Checks of every experiment's table, summary and figures, for the tests."""

import json
import math
import pickle
from pathlib import Path

from vergence.eval.article.experiment import load_experiment
from vergence.eval.article.reported import reported_results
from vergence.eval.reporting.text import render_text


def backwards(jobs):
    """Run jobs from the last to the first, each a copy as a worker process gets it."""
    return [pickle.loads(pickle.dumps(job))() for job in reversed(list(jobs))][::-1]


def covers(rows, experiment):
    """True if a summary has a row for every result that the article reports of an experiment."""
    ours = {(row.experiment, row.quantity, row.method, row.axis) for row in rows}
    theirs = {
        (row.experiment, row.quantity, row.method, row.axis)
        for row in reported_results()
        if row.experiment == experiment
    }
    return bool(theirs) and theirs <= ours


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
    """The text of an experiment's section as the report has it."""
    return render_text(experiment.text, config=config, **experiment.numbers(table, config))


def full_run():
    """The numbers of a full run by experiment, as the docs keep them."""
    docs = Path(__file__).resolve().parents[3] / "docs"
    return json.loads((docs / "results" / "reproduce.json").read_text(encoding="utf-8"))


def uncaptioned(experiment, table, config):
    """Figures without a caption, and captions without a figure, of an experiment."""
    figures = experiment.draw(table, config)
    return set(figures) ^ set(section_text(experiment, table, config).captions)


def stale_names(name, table, config):
    """Names of numbers that the docs keep and a run does not give any more, or the reverse."""
    return set(load_experiment(name).numbers(table, config)) ^ set(full_run()[name])


def empty_panels(figures):
    """Panels of figures, by name and number, in which no data are drawn."""
    return [
        (name, number)
        for name, figure in figures.items()
        for number, panel in enumerate(figure.axes)
        if not any(len(line.get_xdata()) > 1 for line in panel.lines) and not panel.containers
    ]
