"""Calibrate simulated heads from their own movements, and compare errors with stated sigmas.

    python -m benchmarks.head_calibration [--heads N] [--head NAME] [--workers N] [--csv FILE]

It draws N true heads with the spreads of the physical twin. Each looks at a checkerboard at three
places (0.5, 0.9 and 1.5 m) while its neck moves, from 60 poses with 8 dithered frames each, with
corner noise of 0.05 px and joints read by the head's encoders. The nominal head is calibrated on
these frames. Then each true head fixates points 64 times, with angles varied by up to 0.3 degrees:
Table 5's 21 points for the head `physical`, 20 points at the same distances for other heads, and 5
points straight ahead. The table has a row for each head model:

before_95_percent       |error of z| of the nominal head from exact angles and pixels, percent of z:
                        95th percentile over heads at the worst point
calibrated_95_percent   as before, of the calibrated head
mean_95_percent         as calibrated, of the mean of 64 fixations read by the encoders
fixations_95_percent    as mean, of `triangulate_fixations`, which models the quantisation
ahead_95_percent        as fixations, but only straight ahead, 0.5 to 2.5 m
floor_95_percent        as fixations, of the true head: lower limit for any calibration
single_ratio            rms error of single fixations over heads and fixations, relative to that of
                        the true head: worst point
nees                    e^T C^-1 e / n over the directions that the recording determines: mean
nees_error              standard error of nees
told                    number of these directions, mean
left_out                views left out, mean
failed                  heads whose calibration failed
seconds                 processor time of a calibration, mean
"""

import argparse
import sys
import time
from functools import partial
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
import pandas as pd

from vergence.calibration.head.calibrate import HeadCalibration, calibrate_head
from vergence.calibration.head.simulated import quantised, simulate_recording
from vergence.errors import ConfigurationError
from vergence.eval.article.reported import static_points
from vergence.eval.trials.twin_errors import TWIN_SPREADS
from vergence.models.head import HeadModel
from vergence.models.head_file import load_head
from vergence.models.parts import FloatArray
from vergence.reporting.jobs import open_mapper
from vergence.triangulation import Noise, triangulate_views
from vergence.triangulation.fix import triangulate_fixations

HEADS: Final = ("physical", "icub", "turrets")
DISTANCES_M: Final = (0.5, 0.9, 1.5)
"""Distances of the board's places, m (chosen: within reach of a desk)."""
TARGET: Final = "checkerboard:9x6:30"
NOISE_PX: Final = 0.05
"""Standard deviation of corners and of the target's pixels, px (chosen: a good detector)."""
FIXATIONS: Final = 64
"""Fixations of each point (chosen: averages out the quantisation)."""
DITHER_RAD: Final = float(np.deg2rad(0.3))
"""Largest variation of an actuator between fixations, rad (chosen: several encoder counts)."""
AHEAD_M: Final = (0.5, 1.0, 1.5, 2.0, 2.5)
"""Distances of the points straight ahead, m (chosen: near to far)."""
TOLD: Final = 0.1
"""Ratio of posterior to prior variance below which a direction counts as determined (chosen)."""


class Judged(NamedTuple):
    """Errors of one head; depth errors in percent, one per point."""

    before: FloatArray
    calibrated: FloatArray
    mean: FloatArray
    fixations: FloatArray
    floor: FloatArray
    single: FloatArray
    """(points,) mean squared depth error of single fixations."""
    single_floor: FloatArray
    nees: float
    told: int
    left_out: int
    seconds: float


def points_of(head: HeadModel) -> FloatArray:
    """(points, 3) points of Table 5 or similar ones, followed by those straight ahead."""
    eyes = head.camera_poses(head.rest())[:, :3, 3].mean(axis=0)
    ahead = eyes + np.array([[0.0, 0.0, z] for z in AHEAD_M])
    if head.name == "physical":
        return np.concatenate([static_points("physical"), ahead])
    z = np.linspace(0.5, 2.5, 20)
    aside = np.column_stack([0.3 * z * np.cos(np.arange(20)), 0.1 * z * np.sin(np.arange(20)), z])
    return np.concatenate([eyes + aside, ahead])


def depth_percent(head: HeadModel, q: FloatArray, pixels: FloatArray, at: FloatArray) -> FloatArray:
    """Error of z, percent of z."""
    z = at[..., 2]
    return np.asarray(100.0 * (triangulate_views(head, q, pixels).point[..., 2] - z) / z)


def judge(name: str, seed: int, number: int) -> Judged | str:
    """Draw a head, calibrate it, and fixate the points; return the refusal if it fails."""
    nominal = load_head(name)
    rng = np.random.default_rng([seed, number])
    true = nominal.perturbed(rng, TWIN_SPREADS)
    frames = simulate_recording(
        nominal, true, rng, target=TARGET, distances_m=DISTANCES_M, noise_px=NOISE_PX
    ).frames
    started = time.process_time()
    try:
        found = calibrate_head(nominal, frames)
    except ConfigurationError as error:
        return f"{name} {number}: {error}"
    seconds = time.process_time() - started
    points = points_of(nominal)
    q = true.fixate(points, warn=False)
    pixels = true.project(q, points)
    own = true.actuation
    moves = (own.upper > own.lower)[3:]
    several: dict[str, list[float]] = {key: [] for key in ("mean", "fixations", "floor")}
    single: dict[str, list[float]] = {"single": [], "single_floor": []}
    noise = Noise(pixel_px=NOISE_PX)
    for point, posture in zip(points, q, strict=True):
        angles = np.tile(own.actuators_of(posture), (FIXATIONS, 1))
        angles[:, 3:] += moves * rng.uniform(-DITHER_RAD, DITHER_RAD, (FIXATIONS, 4))
        looks = own.joints_of(angles)
        seen = true.project(looks, point) + NOISE_PX * rng.standard_normal((FIXATIONS, 2, 2))
        read = quantised(nominal, looks)
        each = depth_percent(found.head, read, seen, point)
        several["mean"].append(float(each.mean()))
        single["single"].append(float(np.mean(each**2)))
        exact = depth_percent(true, read, seen, point)
        single["single_floor"].append(float(np.mean(exact**2)))
        for key, head in (("fixations", found.head), ("floor", true)):
            fix = triangulate_fixations(head, read, seen, noise)
            several[key].append(100.0 * float((fix.point - point)[2] / point[2]))
    nees, told = surprise(found, true)
    return Judged(
        before=depth_percent(nominal, q, pixels, points),
        calibrated=depth_percent(found.head, q, pixels, points),
        **{key: np.array(values) for key, values in (several | single).items()},
        nees=nees,
        told=told,
        left_out=int((frames.seen.any(axis=-1) & ~found.kept_views).sum()),
        seconds=seconds,
    )


def surprise(found: HeadCalibration, true: HeadModel) -> tuple[float, int]:
    """Mean squared normalised error over the directions that are determined; and their number."""
    spreads = found.solution.problem.prior_sigma
    free = spreads > 0.0
    error = (found.solution.state.head_parameters - true.parameters(found.nominal_head).values)[
        free
    ]
    scale = spreads[free]
    values, vectors = np.linalg.eigh(found.covariance[np.ix_(free, free)] / np.outer(scale, scale))
    squares = (vectors.T @ (error / scale)) ** 2 / values
    return float(squares[values < TOLD].mean()), int((values < TOLD).sum())


def row_of(name: str, judged: list[Judged], failed: int) -> dict[str, Any]:
    """Row of the table."""
    ahead = len(AHEAD_M)

    def most(values: list[FloatArray], points: slice = slice(None)) -> float:
        percent = np.abs(np.array(values))[:, points]
        return float(np.nanmax(np.percentile(percent, 95.0, axis=0)))

    single = np.sqrt(
        np.mean([one.single for one in judged], axis=0)
        / np.mean([one.single_floor for one in judged], axis=0)
    )
    nees = np.array([one.nees for one in judged])
    return {
        "head": name,
        "heads": len(judged),
        "before_95_percent": most([one.before for one in judged]),
        "calibrated_95_percent": most([one.calibrated for one in judged]),
        "mean_95_percent": most([one.mean for one in judged]),
        "fixations_95_percent": most([one.fixations for one in judged]),
        "ahead_95_percent": most([one.fixations for one in judged], slice(-ahead, None)),
        "floor_95_percent": most([one.floor for one in judged]),
        "single_ratio": float(single.max()),
        "nees": float(nees.mean()),
        "nees_error": float(nees.std() / np.sqrt(len(nees))),
        "told": float(np.mean([one.told for one in judged])),
        "left_out": float(np.mean([one.left_out for one in judged])),
        "failed": failed,
        "seconds": float(np.mean([one.seconds for one in judged])),
    }


def main(arguments: list[str] | None = None) -> None:
    """Measure, and print a row for each head."""
    parser = argparse.ArgumentParser(description=str(__doc__).partition("\n")[0])
    parser.add_argument("--heads", type=int, default=100, metavar="N", help="true heads")
    parser.add_argument("--head", choices=HEADS, action="append", help="models; all by default")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--workers", type=int, metavar="N", help="processes")
    parser.add_argument("--csv", type=Path, metavar="FILE", help="keep the table")
    options = parser.parse_args(arguments)
    rows = []
    with open_mapper(options.workers, None) as mapper:
        for name in options.head or HEADS:
            jobs = [partial(judge, name, options.seed, number) for number in range(options.heads)]
            results = mapper(jobs)
            refused = [one for one in results if isinstance(one, str)]
            for line in refused:
                print(line, file=sys.stderr)
            rows.append(
                row_of(name, [one for one in results if not isinstance(one, str)], len(refused))
            )
    table = pd.DataFrame(rows)
    print(table.T.to_string(float_format="{:.4g}".format))
    if options.csv:
        table.to_csv(options.csv, index=False, float_format="%.4g")


if __name__ == "__main__":
    main()
