"""Compare head-eye calibrations with the calibration of the whole head on simulated heads.

    python -m benchmarks.head_eye [--heads N] [--off-axis F] [--csv FILE]

It draws N true heads of the physical twin, with cameras that are also rotated by some degrees. Each
looks at a checkerboard from 60 poses with 8 frames each, with corner noise of 0.05 px and joints
read by 12-bit encoders. The nominal head is calibrated on these frames. A head takes some 13 s.
Every method gets the same frames:

nominal        the nominal head of the file
single_eye     hand-eye calibration of each eye by itself, closed form
both_eyes      both transforms at once, ITPC-style, reconstructed, closed form
reprojection   both_eyes refined on the corners, angles estimated within the encoders' quantisation
whole_head     links, offsets, head-eye transforms and cameras: `calibrate_head`

Each true head then fixates Table 5's 21 points exactly, and the calibrated one triangulates them
from the true joint angles and pixels. The table has a row for each method:

depth_0.5_percent    |error of z|, percent of z, at the point 0.5 m ahead: 95th percentile of heads
depth_1_percent      as above, 1.0 m ahead
depth_2.5_percent    as above, 2.5 m ahead
depth_worst_percent  as above, at each head's worst point
depth_rms_mm         error of z over all points and heads, rms
no_answer_percent    points whose lines of sight do not meet ahead: their error counts as infinite
axis_deg             angle between the optical axes and the true ones in N, rms
vergence_deg         error of the angle between both axes seen from above, rms
kept_percent         views used by the calibration
failed               heads whose calibration failed
seconds              time of a calibration, mean
"""

import argparse
import dataclasses
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from rich.progress import track

from vergence.calibration.head.calibrate import calibrate_head
from vergence.calibration.head.recording import HeadFrames
from vergence.calibration.head.simulated import simulate_recording
from vergence.errors import ConfigurationError
from vergence.eval.article.hand_eye import (
    HeadEyeFit,
    refine_by_reprojection,
    solve_both_eyes,
    solve_each_eye,
)
from vergence.eval.article.reported import static_points
from vergence.eval.trials.twin_errors import TWIN_SPREADS
from vergence.models.head import HeadModel
from vergence.models.head_file import load_head
from vergence.models.parts import FloatArray
from vergence.triangulation import triangulate_views

ERRORS: Final = dataclasses.replace(
    TWIN_SPREADS, head_eye_rad=np.deg2rad(2.0).item(), head_eye_m=0.002
)
"""Spreads of the twin before head-eye calibration, with cameras mounted by eye."""
DEPTHS_M: Final = (0.5, 1.0, 2.5)
"""Depths of the points ahead with columns of their own, m (chosen: near to far)."""


class Calibrated(NamedTuple):
    """Result of a method."""

    head: HeadModel
    kept: float
    """Fraction of the views that were used."""


def _nominal(head: HeadModel, frames: HeadFrames) -> Calibrated:
    return Calibrated(head, float("nan"))


def _whole_head(head: HeadModel, frames: HeadFrames) -> Calibrated:
    found = calibrate_head(head, frames)
    return Calibrated(found.head, float(found.kept_corners.mean()))


def _head_eye(
    find: Callable[[HeadModel, HeadFrames], HeadEyeFit],
) -> Callable[[HeadModel, HeadFrames], Calibrated]:
    def calibrated(head: HeadModel, frames: HeadFrames) -> Calibrated:
        found = find(head, frames)
        return Calibrated(head.replace(head_eye=found.head_eye), float(found.kept_views.mean()))

    return calibrated


METHODS: Final[dict[str, Callable[[HeadModel, HeadFrames], Calibrated]]] = {
    "nominal": _nominal,
    "single_eye": _head_eye(solve_each_eye),
    "both_eyes": _head_eye(solve_both_eyes),
    "reprojection": _head_eye(lambda head, frames: refine_by_reprojection(head, frames,
                                                                   solve_both_eyes(head, frames))),
    "whole_head": _whole_head,
}  # fmt: skip


def axes_of(head: HeadModel, q: FloatArray) -> FloatArray:
    """(points, 2, 3) optical axes in N."""
    return head.camera_poses(q)[..., :3, 2]


def measured(found: HeadModel, true: HeadModel) -> dict[str, Any]:
    """Errors of a calibrated head at Table 5's points."""
    points = static_points("physical")
    q = true.fixate(points)
    fix = triangulate_views(found, q, true.project(q, points))
    error = np.where(fix.valid[:, None], fix.point, np.inf) - points
    axes = [axes_of(head, q) for head in (found, true)]
    apart = np.arccos(np.clip((axes[0] * axes[1]).sum(axis=-1), -1.0, 1.0))
    above = np.arctan2(axes[0][..., 0], axes[0][..., 2]) - np.arctan2(
        axes[1][..., 0], axes[1][..., 2]
    )
    return {
        "percent": 100.0 * np.abs(error[:, 2]) / points[:, 2],
        "depth_mm": 1000.0 * error[:, 2],
        "axis_deg": np.rad2deg(apart),
        "vergence_deg": np.rad2deg(above[:, 0] - above[:, 1]),
    }


def row_of(method: str, heads: list[dict[str, Any]], seconds: float, failed: int) -> dict[str, Any]:
    """A row of the table."""
    row: dict[str, Any] = {"method": method, "heads": len(heads)}
    if heads:
        z = static_points("physical")[:, 2]
        percent = np.stack([head["percent"] for head in heads])
        for depth in DEPTHS_M:
            row[f"depth_{depth:g}_percent"] = _most(percent[:, int(np.abs(z - depth).argmin())])
        row["depth_worst_percent"] = _most(percent.max(axis=1))
        row["no_answer_percent"] = 100.0 * float(np.mean(np.isinf(percent)))
        for name, column in (("depth_mm", "depth_rms_mm"), *((n, n) for n in ANGLES)):
            row[column] = _root_mean_square(np.stack([head[name] for head in heads]))
        row["kept_percent"] = 100.0 * float(np.mean([head["kept"] for head in heads]))
    return row | {"failed": failed, "seconds": seconds}


ANGLES: Final = ("axis_deg", "vergence_deg")


def _most(values: FloatArray) -> float:
    """95th percentile without interpolation, as some values may be infinite."""
    return float(np.percentile(values, 95.0, method="nearest"))


def _root_mean_square(values: NDArray[np.float64]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def table_of(count: int, seed: int, off_axis: float) -> pd.DataFrame:
    """Draw heads and calibrate each by every method."""
    nominal = load_head("physical")
    heads: dict[str, list[dict[str, Any]]] = {method: [] for method in METHODS}
    seconds, failed = dict.fromkeys(METHODS, 0.0), dict.fromkeys(METHODS, 0)
    for number in track(range(count), "heads"):
        rng = np.random.default_rng([seed, number])
        true = nominal.perturbed(rng, ERRORS)
        frames = simulate_recording(nominal, true, rng, off_axis=off_axis).frames
        for method, calibrate in METHODS.items():
            started = time.perf_counter()
            try:
                found = calibrate(nominal, frames)
                heads[method].append(measured(found.head, true) | {"kept": found.kept})
            except ConfigurationError as refused:
                print(f"{method}, head {number}: {refused}", file=sys.stderr)
                failed[method] += 1
            seconds[method] += time.perf_counter() - started
    rows = [
        row_of(method, heads[method], seconds[method] / max(count, 1), failed[method])
        for method in METHODS
    ]
    return pd.DataFrame(rows)


def main(arguments: list[str] | None = None) -> None:
    """Measure, and print a row for each method."""
    parser = argparse.ArgumentParser(description=str(__doc__).partition("\n")[0])
    parser.add_argument("--heads", type=int, default=20, metavar="N", help="true heads")
    parser.add_argument("--off-axis", type=float, default=1.0, metavar="F",
                        help="how far the eyes look beside the board, 0 to fixate it")  # fmt: skip
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--csv", type=Path, metavar="FILE", help="keep the table")
    options = parser.parse_args(arguments)
    if options.heads < 1:
        parser.error(f"--heads: expected at least 1, got {options.heads}")
    table = table_of(options.heads, options.seed, options.off_axis)
    print(table.T.to_string(float_format="{:.4g}".format))
    if options.csv:
        table.to_csv(options.csv, index=False, float_format="%.6g")


if __name__ == "__main__":
    main()
