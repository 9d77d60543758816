"""Results of the physical twin's calibration: summary rows, and numbers for the text."""

from typing import Final

import numpy as np
import pandas as pd

from vergence.eval.article.experiment import SummaryRow
from vergence.eval.article.head_eye.trials import STAGES, HeadEyeConfig
from vergence.models.parts import FloatArray
from vergence.reporting.text import Numbers

NAME: Final = "head-eye"
ARTICLE_PERCENT: Final = 6.98
"""Largest depth error by ITPC at 2.5 m, percent of depth (measured: reported by the article)."""


def depth_errors_percent(table: pd.DataFrame, stage: str, reading: str = "exact") -> FloatArray:
    """(heads, points) absolute depth errors, percent of depth; infinite where there is no fix."""
    rows = table[(table["stage"] == stage) & (table["reading"] == reading)]
    share = 100.0 * rows["error_z_mm"].abs() / rows["truth_z_mm"]
    wide = rows.assign(percent=share).pivot(index="head", columns="point", values="percent")
    return np.asarray(wide.fillna(np.inf).to_numpy(), dtype=np.float64)


def worst_depth_error_percent(table: pd.DataFrame, stage: str, reading: str = "exact") -> float:
    """The largest depth error of all heads, percent of depth."""
    return float(depth_errors_percent(table, stage, reading).max())


def summarise(table: pd.DataFrame, config: HeadEyeConfig) -> list[SummaryRow]:
    """Summarise the largest depth error of each stage; the article has no such values."""
    del config
    return [
        SummaryRow.of(NAME, f"largest depth error, {stage}, joints read {how}", "itpc", "z",
                      None, worst_depth_error_percent(table, stage, reading), unit="%")
        for stage in STAGES
        for reading, how in (("exact", "exactly"), ("encoders", "by the encoders"))
    ]  # fmt: skip


def numbers(table: pd.DataFrame, config: HeadEyeConfig) -> Numbers:
    """Collect the numbers for the text."""
    values = {"heads": float(config.heads), "article_percent": ARTICLE_PERCENT}
    for stage in STAGES:
        name = stage.replace(" ", "_")
        values[f"{name}_percent"] = worst_depth_error_percent(table, stage)
        values[f"{name}_encoders_percent"] = worst_depth_error_percent(table, stage, "encoders")
        values[f"{name}_median_percent"] = float(
            np.median(depth_errors_percent(table, stage).max(axis=1))
        )
    return values
