"""The learning curve: one row per evaluation, as a table and as a figure."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import pandas as pd

from vergence.files import atomic_file
from vergence.reporting.style import (
    BLACK,
    BLUE,
    ORANGE,
    figure_style,
    legend_below,
    log_axis,
    new_figure,
    save_figure,
)

COLUMNS: Final = {
    "step": "control steps learned from",
    "headline": "the scenario's headline metric on validation trials: s, or px of a moving target",
    "settled_fraction": "share of validation trials that settle to the scenario's leading band; of "
    "the targets not lost, if they move",
    "mean": "the metric's mean, a failure counting as the whole trial",
    "baseline": "the best baseline's headline metric on the same trials",
    "gain": "baseline by headline: above 1 better, below 1 worse than the baseline",
    "reward": "mean sum of rewards of the training episodes since the last row",
    "length": "their mean length, steps",
    "steps_per_s": "control steps learned from a second since the last row, evaluation left out",
    "best": "whether this is the best so far",
}
"""Columns of the curve, and their meanings."""


def write_curve(folder: Path, rows: Sequence[dict[str, Any]]) -> None:
    """Write `curve.csv` atomically."""
    table = pd.DataFrame(list(rows), columns=list(COLUMNS))
    with atomic_file(folder / "curve.csv") as partial:
        table.to_csv(partial, index=False)


def draw_curve(
    folder: Path, rows: Sequence[dict[str, Any]], baselines: dict[str, float], title: str, unit: str
) -> None:
    """Draw `curve.png` and `curve.svg`.

    Args:
        folder: the run folder.
        rows: the curve.
        baselines: headline metrics by name.
        title: title of the figure.
        unit: unit of the headline metric, `s` or `px`.
    """
    table = pd.DataFrame(list(rows), columns=list(COLUMNS))
    millions = table["step"] / 1e6
    with figure_style():
        figure = new_figure(9.0, 4.2)
        left, right = figure.subplots(1, 2)
        left.plot(millions, table["headline"], color=BLUE, label="validation")
        best = table[table["best"].astype(bool)].tail(1)
        left.plot(best["step"] / 1e6, best["headline"], "o", color=BLUE, label="kept as best")
        for (name, value), dash in zip(baselines.items(), ("--", ":", "-."), strict=False):
            left.axhline(value, color=ORANGE, linestyle=dash, label=name)
        log_axis(left)
        what = "median settle time" if unit == "s" else "tracking RMS"
        left.set(xlabel="million control steps", ylabel=f"{what} ({unit})", title=title)
        right.plot(millions, table["reward"], color=BLACK)
        right.set(
            xlabel="million control steps", ylabel="sum of rewards of an episode", title="training"
        )
        legend_below(figure, 5, fontsize=10)
    save_figure(figure, folder / "curve")
