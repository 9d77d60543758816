"""The gain sweep (Fig. 15): settle time and overshoot of a step, and the loop delay behind them."""

from math import isnan

import numpy as np
import pandas as pd

from vergence.eval.article.experiment import Experiment, SummaryRow, compare
from vergence.eval.article.gain_sweep.figures import draw
from vergence.eval.article.gain_sweep.findings import (
    ARTICLE_GAIN,
    Findings,
    at_gain,
    fastest,
    find,
    sweep,
)
from vergence.eval.article.gain_sweep.trials import PLANE_STEPS, GainSweepConfig, run

NAME = "gain sweep"


def summarise(table: pd.DataFrame, config: GainSweepConfig) -> list[SummaryRow]:
    """Ours beside the article's one figure, and figures of our own.

    The verdict is `none began` where no overshoot begins in the sweep, and `not reported` where
    the article has no figure.
    """
    found = find(table, config)
    rows = []
    for axis, steps in (("y", ("+y", "-y")), ("x", ("+x", "-x"))):
        gains = [found.onset[step] for step in steps]
        low, high = min(gains), max(gains)
        verdict = compare(low, high, ARTICLE_GAIN, None) if np.isfinite(gains).all() else _NONE
        rows.append(_row("gain at which overshoot begins", axis, "1/s", low, high, verdict, True))
        for gain in (least_gain(table), ARTICLE_GAIN):
            settled = [at_gain(sweep(table, step), gain)["settle_1px_s"] for step in steps]
            what = f"settle time to 1 px at k = {gain:g}"
            rows.append(_row(what, axis, "s", min(settled), max(settled), _UNKNOWN))
    best = [float(fastest(sweep(table, step))["k1_per_s"]) for step in ("+y", "-y")]
    rows.append(_row("fastest gain", "y", "1/s", min(best), max(best), _UNKNOWN))
    delays = [1000.0 * found.period_s * delay for delay in _delays(found)]
    what = f"image delay identified with a lag of {1000.0 * found.lag_s:g} ms"
    rows.append(_row(what, "y", "ms", min(delays), max(delays), _UNKNOWN))
    return rows


_NONE = "none began"
_UNKNOWN = "not reported"


def _row(
    quantity: str, axis: str, unit: str, low: float, high: float, verdict: str, known: bool = False
) -> SummaryRow:
    return SummaryRow(
        experiment=NAME,
        quantity=quantity,
        method="ibvs",
        axis=axis,
        unit=unit,
        article_low=ARTICLE_GAIN if known else None,
        article_high=None,
        ours_low=float(low),
        ours_high=float(high),
        verdict=verdict,
    )


def least_gain(table: pd.DataFrame) -> float:
    """Where the sweep begins, 1/s."""
    return float(sweep(table, "+y")["k1_per_s"].min())


def _delays(found: Findings) -> list[float]:
    """Image delays of the families that go with the head's own lag, control periods."""
    return [family.delay_with(found.lag_s) for family in found.families]


def conclude(table: pd.DataFrame, config: GainSweepConfig) -> str:
    """What the sweep says, in one paragraph."""
    found = find(table, config)
    return " ".join(
        [*_about_settling(table, found), *_about_onset(found, config), *_about_loops(found, config)]
    )


def _about_settling(table: pd.DataFrame, found: Findings) -> list[str]:
    rows = sweep(table, "-y")
    slow, reached = at_gain(rows, least_gain(table)), at_gain(rows, ARTICLE_GAIN)
    best = fastest(rows)
    up_to = rows[rows["k1_per_s"] <= ARTICLE_GAIN + 1e-9]["settle_1px_s"]
    shortens = bool((up_to.diff().dropna() <= 0.0).all())
    said = (
        f"As in the article, raising the gain shortens the gaze shift: from "
        f"{slow['settle_1px_s']:.2f} s at k = {slow['k1_per_s']:g} to "
        f"{reached['settle_1px_s']:.2f} s at k = {reached['k1_per_s']:g} (to 1 px; "
        f"{reached['settle_05px_s']:.2f} s to 0.5 px)."
        if shortens
        else f"Unlike in the article, raising the gain up to {ARTICLE_GAIN:g} does not always "
        f"shorten the gaze shift: it takes {slow['settle_1px_s']:.2f} s at k = "
        f"{slow['k1_per_s']:g} and {reached['settle_1px_s']:.2f} s at k = {reached['k1_per_s']:g}."
    )
    plane = table[table["case"] == "plane"]
    plane = plane[plane["k2_per_s"] == at_gain(plane, ARTICLE_GAIN)["k2_per_s"]]
    change = {step: 1000.0 * _spread(plane[plane["step"] == step]) for step in PLANE_STEPS}
    return [
        said,
        f"The fastest gain is {best['k1_per_s']:g}, with {best['settle_1px_s']:.2f} s and "
        f"{100.0 * best['overshoot']:.1f} % of overshoot; beyond it the overshoot leaves the band "
        f"again.",
        f"Both directions of y agree within {1000.0 * found.direction_settle_s:.0f} ms, and the "
        f"same steps with masses and servos within {1000.0 * found.dynamics_settle_s:.0f} ms and "
        f"{100.0 * found.dynamics_overshoot:.2f} % of overshoot.",
        f"With k2 = {plane['k2_per_s'].iloc[0]:g}, k1 from {plane['k1_per_s'].min():g} to "
        f"{plane['k1_per_s'].max():g} changes the settle time by {change['+y']:.0f} ms after the "
        f"article's step in y and by {change['+x+y']:.0f} ms after a step in both"
        f"{': a step in y tests k2 alone' if change['+y'] < 0.05 * change['+x+y'] else ''}.",
    ]


def _spread(rows: pd.DataFrame) -> float:
    return float(rows["settle_1px_s"].max() - rows["settle_1px_s"].min())


def _about_onset(found: Findings, config: GainSweepConfig) -> list[str]:
    level = f"{100.0 * config.onset_fraction:g} %"
    gains = list(found.onset.values())
    if not np.isfinite(gains).all():
        return [f"Overshoot of {level} does not begin within this sweep in every direction."]
    least, greatest = min(gains), max(gains)
    span = " to ".join(dict.fromkeys([f"{least:.2f}", f"{greatest:.2f}"]))
    low, high = min(config.onset_gains), max(config.onset_gains)
    if low <= least and greatest <= high:
        judged = f"just above the article's {ARTICLE_GAIN:g}"
    elif greatest < ARTICLE_GAIN:
        judged = f"below the article's {ARTICLE_GAIN:g}"
    else:
        judged = f"not just above the article's {ARTICLE_GAIN:g}"
    return [f"Overshoot of {level} of the step begins at k = {span}, {judged}."]


def _about_loops(found: Findings, config: GainSweepConfig) -> list[str]:
    low, high = min(_delays(found)), max(_delays(found))
    loop = f"{found.latency_frames} frames and {1000.0 * found.lag_s:g} ms"
    if isnan(low) or isnan(high):
        return [f"None of the image delays tried goes with our rig's lag, {loop}."]
    inside = low <= found.latency_frames <= high
    period = 1000.0 * found.period_s
    onset = " and ".join(f"{family.gain:g}" for family in found.families)
    ends = [
        f"at {family.gain:g} between {period * family.longest_delay_frames:.0f} ms of image "
        f"delay without a lag and {1000.0 * family.lags_s[0]:.0f} ms of lag without a delay"
        for family in found.families
    ]
    critical = 1000.0 / (4.0 * ARTICLE_GAIN)
    return [
        f"An onset between {onset} fits a family of loops and not one: {', '.join(ends)}; with a "
        f"lag of {1000.0 * found.lag_s:g} ms it means {low:.1f} to {high:.1f} frames of "
        f"{period:.3g} ms, and our rig ({loop}) lies {'between' if inside else 'outside'}.",
        f"What counts as overshoot matters: were the article's onset the first overshoot at all, "
        f"linear theory would leave {1000.0 / (np.e * ARTICLE_GAIN):.0f} ms of delay or "
        f"{critical:.1f} ms of lag.",
    ]


EXPERIMENT = Experiment(
    name="gain-sweep",
    title="Gain sweep",
    article="Section 5.3.1, Fig. 15",
    what=(
        "A target that both eyes hold at (0, -100, 1000) mm jumps by 100 mm. The article sweeps "
        "k1 = k2 from 0.5 to 4 for a step in y and reports overshoot above 4; we sweep to 6, in "
        "both directions of y and of x, as k1 acts on x alone, with masses at some gains, and "
        "take k1 and k2 apart on a coarse plane. Settle time is when both eyes' true errors enter "
        "1 px (0.5 px) to stay, from the jump.\n\n"
        "The gain at which overshoot begins tells how late the loop acts. We look for all pairs "
        "of image delay and joint lag whose overshoot reaches 0.5 % of the step at k = 4.0 and at "
        "4.2, and see where our rig lies among them."
    ),
    config=GainSweepConfig,
    quick={"gain_step": 0.25, "plane_step": 0.5, "lag_step_s": 0.005, "mujoco_gains": (1.0, 4.0)},
    run=run,
    summarise=summarise,
    draw=draw,
    conclude=conclude,
)
