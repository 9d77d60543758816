"""Figure of the physical twin's calibration."""

from typing import Any, Final

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from vergence.eval.article.head_eye.findings import ARTICLE_PERCENT, depth_errors_percent
from vergence.eval.article.head_eye.trials import HeadEyeConfig
from vergence.reporting.style import (
    ARTICLE_STYLE,
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    figure_style,
    legend_below,
    log_axis,
    new_figure,
)

_STYLES: Final[dict[str, dict[str, Any]]] = {
    "before": {"color": GREY, "marker": "o"},
    "closed form": {"color": ORANGE, "marker": "s", "label": "head-eye, closed form"},
    "reprojection": {"color": BLUE, "marker": "^", "label": "head-eye, reprojection"},
    "whole head": {"color": GREEN, "marker": "D"},
}
_PANELS: Final = {"exact": "joints read exactly", "encoders": "joints read by the encoders"}


def draw(table: pd.DataFrame, config: HeadEyeConfig) -> dict[str, Figure]:
    """Draw all figures, by name."""
    del config
    depth = np.unique(table["truth_z_mm"].to_numpy()) / 1000.0
    with figure_style():
        figure = new_figure(9.0, 4.6)
        for panel, (reading, title) in zip(
            figure.subplots(1, 2, sharey=True), _PANELS.items(), strict=True
        ):
            for stage, style in _STYLES.items():
                errors = depth_errors_percent(table, stage, reading).max(axis=0)
                panel.plot(depth, errors, **({"label": stage} | style), markersize=4)
            panel.axhline(ARTICLE_PERCENT, **ARTICLE_STYLE, label="article's largest, ITPC")
            panel.set(xlabel="depth [m]", title=title)
            log_axis(panel)
        figure.axes[0].set_ylabel("largest |depth error| of the heads [% of depth]")
        legend_below(figure, 3)
    return {"head-eye-depth": figure}
