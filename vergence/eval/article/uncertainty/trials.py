"""Trials of propagated uncertainties against the real detector's scatter, and their table."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any, Final

import numpy as np
import pandas as pd

from vergence.eval.article.common.closed_loop import (
    MM,
    ClosedLoop,
    corrected_gaze_fix,
    detection_sigma,
    dither_references_px,
    gaze_uncertainty_mm,
    hold_gaze,
    itpc_uncertainty_mm,
)
from vergence.eval.article.common.fixed_view import FixedView, board_poses_in_eyes, shifted_pose
from vergence.eval.article.experiment import job_rng
from vergence.eval.article.reported import static_points
from vergence.eval.article.simulated_static.trials import BOARD
from vergence.eval.article.uncertainty.image_information import cramer_rao_bound
from vergence.models.head_file import load_head
from vergence.models.parts import FloatArray
from vergence.reporting.jobs import Job, Mapper
from vergence.triangulation import Noise, triangulate_gaze, triangulate_views

NAME: Final = "uncertainty"
AHEAD: Final = "ahead"
ASIDE: Final = "aside"
# Keys of the random streams, one per kind of trial (numerical).
_PROPAGATION, _LOOP, _LOOP_IMAGES, _AVERAGING, _REACH = range(5)
_REACH_PX: Final = 0.004
"""Half range of the optical axes' jitter in the image, px (chosen: about twice their standard
deviation at a gain of 4)."""


@dataclass(frozen=True, kw_only=True)
class UncertaintyConfig:
    """Configuration of the uncertainties."""

    draws: int = 1150
    """Images of each eye at a fixed pose."""
    point_step: int = 1
    """Step through Table 3's 21 points, from the first."""
    aside_deg: float = 25.0
    """Angle to the side at which every fifth of these points is used once more, degrees."""
    gains: tuple[float, ...] = (0.5, 1.0, 2.0, 3.0, 4.0)
    """Gains of the closed loops with white noise, 1/s."""
    heads: int = 100
    """Number of heads side by side at each of those gains."""
    loop_samples: int = 1200
    """Control periods recorded of each of these loops."""
    image_gains: tuple[float, ...] = (1.0, 2.0, 4.0)
    """Gains of the closed loops with images, 1/s."""
    image_samples: int = 3000
    """Control periods recorded of each loop with images."""
    image_depth_m: float = 2.0
    """Depth of the board for the loops with images, m."""
    reach_draws: int = 400
    """Images at each of nine sub-pixel offsets within the axes' jitter, for the bias there."""
    averaging_depths_m: tuple[float, ...] = (1.0, 1.5, 2.5)
    """Depths at which averaging is measured, m."""
    frames: int = 1024
    """Largest number of averaged frames."""
    replicates: int = 10
    """Number of averages at each depth, each at another sub-pixel position."""
    dither_side: int = 4
    """References per side of a dithered fixation, see `closed_loop.dither_references_px`."""


def run(config: UncertaintyConfig, seed: int, mapper: Mapper) -> pd.DataFrame:
    """See `vergence.eval.article.experiment.Experiment`."""
    points = range(0, len(static_points("simulated")), config.point_step)
    jobs: list[Job] = [partial(_propagation, config, seed, point, AHEAD) for point in points]
    jobs += [partial(_propagation, config, seed, point, ASIDE) for point in list(points)[::5]]
    jobs += [partial(_loop, config, seed, number) for number in range(len(config.gains))]
    jobs += [partial(_loop_images, config, seed, i) for i in range(len(config.image_gains))]
    jobs += [partial(_bias_within_reach, config, seed, axis) for axis in range(2)]
    jobs += [
        partial(_averaging, config, seed, depth, replicate)
        for depth in range(len(config.averaging_depths_m))
        for replicate in range(config.replicates)
    ]
    return pd.DataFrame([row for rows in mapper(jobs) for row in rows])


def _row(part: str, quantity: str, unit: str, value: float, **keys: Any) -> dict[str, Any]:
    return {"part": part, **keys, "quantity": quantity, "unit": unit, "value": float(value)}


def _propagation(
    config: UncertaintyConfig, seed: int, index: int, pose: str
) -> list[dict[str, Any]]:
    """(a) Uncertainties at one pose: propagated, and by Monte Carlo with the real detector."""
    head = load_head("simulated")
    point = static_points("simulated")[index]
    if pose == ASIDE:
        point[0] -= point[2] * np.tan(np.deg2rad(config.aside_deg))
    q = head.fixate(point)
    boards = board_poses_in_eyes(head, q, point)
    rng = job_rng(seed, NAME, _PROPAGATION, index, int(pose == ASIDE))
    pixels = np.stack(
        [FixedView(head, eye).detect([boards[eye]] * config.draws, rng) for eye in range(2)], axis=1
    )
    sigma, truth = detection_sigma(pixels), head.project(q, point)
    mean = np.nanmean(pixels, axis=0)
    error = pixels - head.cameras.principal  # no lens distorts on this rig
    gaze = corrected_gaze_fix(head, np.broadcast_to(q, (len(pixels), 7)), error, boards[:, 2, 3])
    itpc = triangulate_views(head, q, pixels)
    propagated = {
        "gaze": gaze_uncertainty_mm(head, q, sigma),
        "gaze, exact": MM * triangulate_gaze(head, q, Noise(pixel_px=sigma)).sigma,
        "itpc": itpc_uncertainty_mm(head, q, mean, sigma),
    }
    scatter = {
        name: MM * np.nanstd(fix.point, axis=0, ddof=1)
        for name, fix in (("gaze", gaze), ("gaze, exact", gaze), ("itpc", itpc))
    }
    rows = [
        _row(
            "propagation", quantity, "mm", values[method][axis],
            pose=pose, depth_mm=MM * point[2], method=method, axis=letter,
        )
        for quantity, values in (("propagated", propagated), ("Monte Carlo", scatter))
        for method in propagated
        for axis, letter in enumerate("xyz")
    ]  # fmt: skip
    for axis, letter in enumerate("uv"):
        for quantity, value in (
            ("detection sigma", np.sqrt((sigma[:, axis] ** 2).mean())),
            ("detection bias", np.sqrt(((mean - truth)[:, axis] ** 2).mean())),
        ):
            rows.append(
                _row("propagation", quantity, "px", value, pose=pose, depth_mm=MM * point[2],
                     axis=letter)
            )  # fmt: skip
    return rows


def _loop(config: UncertaintyConfig, seed: int, number: int) -> list[dict[str, Any]]:
    """(b) Noise gain (axis scatter over detection noise) of loops with white noise, no images."""
    gain = config.gains[number]
    record = hold_gaze(
        ClosedLoop(
            head=load_head("simulated"),
            target={"kind": "static", "point": (0.0, -0.1, 1.0), "start": "fixation"},
            plant="kinematic",
            num=config.heads,
            samples=config.loop_samples,
            settle_s=4.0 / gain,
            gain=gain,
            seed=int(job_rng(seed, NAME, _LOOP, number).integers(2**63)),
        )
    )
    # without bias the optical axes scatter around the target itself
    axis_px = record.true_pixels_at_exposure - load_head("simulated").cameras.principal
    return _scatter("white noise", gain, np.sqrt((axis_px**2).mean()), _noise(record))


def _loop_images(config: UncertaintyConfig, seed: int, number: int) -> list[dict[str, Any]]:
    """(b) Noise gain of one head's loop with images; scatter about the mean."""
    gain = config.image_gains[number]
    record = hold_gaze(
        ClosedLoop(
            head=load_head("simulated"),
            target={
                "kind": "static",
                "point": (0.0, -0.1, config.image_depth_m),
                "start": "fixation",
            },
            plant_options=BOARD,
            samples=config.image_samples,
            settle_s=4.0 / gain,
            gain=gain,
            seed=int(job_rng(seed, NAME, _LOOP_IMAGES, number).integers(2**63)),
        )
    )
    sigma = np.sqrt(record.true_pixels_at_exposure.var(axis=0).mean())
    return _scatter("images", gain, sigma, _noise(record))


def _bias_within_reach(config: UncertaintyConfig, seed: int, axis: int) -> list[dict[str, Any]]:
    """(b) Variation of the bias in rendered images over the range of the axes' jitter."""
    head = load_head("simulated")
    point = np.array([0.0, -0.1, config.image_depth_m])
    board = board_poses_in_eyes(head, head.fixate(point), point)[0]
    view = FixedView(head, 0)
    rng = job_rng(seed, NAME, _REACH, axis)
    means, squares = [], []
    for offset in np.linspace(-_REACH_PX, _REACH_PX, 9):
        pose = shifted_pose(head, 0, board, offset * np.eye(2)[axis])
        error = view.detect([pose] * config.reach_draws, rng)[:, axis] - view.true_pixel(pose)[axis]
        means.append(np.nanmean(error))
        squares.append(np.nanvar(error, ddof=1) / config.reach_draws)
    # subtract the variance of the means due to noise
    bias = np.sqrt(max(np.var(means, ddof=1) - np.mean(squares), 0.0))
    return [_row("loop", "bias within reach", "px", bias, source="images", axis="uv"[axis])]


def _noise(record: Any) -> float:
    noise = record.pixels - record.true_pixels_at_exposure
    return float(np.sqrt(np.nanvar(noise, axis=0).mean()))


def _scatter(source: str, gain: float, axis_px: float, noise_px: float) -> list[dict[str, Any]]:
    keys = {"source": source, "gain_per_s": gain}
    return [
        _row("loop", "axis sigma", "px", axis_px, **keys),
        _row("loop", "detection sigma", "px", noise_px, **keys),
        _row("loop", "noise gain", "1", axis_px / noise_px, **keys),
    ]


def _averaging(
    config: UncertaintyConfig, seed: int, index: int, replicate: int
) -> list[dict[str, Any]]:
    """(c) Errors of means of n frames of one eye, still and dithered; the bound of one frame."""
    head = load_head("simulated")
    depth = config.averaging_depths_m[index]
    point = np.array([0.0, -0.1, depth])
    rng = job_rng(seed, NAME, _AVERAGING, index, replicate)
    centred = board_poses_in_eyes(head, head.fixate(point), point)[0]
    board = shifted_pose(head, 0, centred, rng.uniform(-0.5, 0.5, 2))
    view = FixedView(head, 0)
    references = np.asarray(dither_references_px(config.dither_side))
    order = rng.permutation(np.arange(config.frames) % len(references))
    keys = {"depth_mm": MM * depth, "replicate": replicate}
    rows = []
    for fixation, poses in (
        ("still", [board] * config.frames),
        ("dithered", [shifted_pose(head, 0, board, references[place]) for place in order]),
    ):
        truth = np.stack([view.true_pixel(pose) for pose in poses])
        error = view.detect(poses, rng) - truth
        for frames, mean in _means(error):
            for axis, letter in enumerate("uv"):
                rows.append(
                    _row("averaging", "error", "px", mean[axis], fixation=fixation, axis=letter,
                         frames=frames, **keys)
                )  # fmt: skip
    for window, sigma in zip(("board", "window"), cramer_rao_bound(head, 0, board), strict=True):
        rows += [
            _row("bound", window, "px", sigma[axis], axis=letter, frames=1, **keys)
            for axis, letter in enumerate("uv")
        ]
    return rows


def _means(error: FloatArray) -> Iterator[tuple[int, FloatArray]]:
    """Means of the first n errors for n = 1, 4, 16 and so on, and of all."""
    frames = 1
    while frames < len(error):
        yield frames, np.nanmean(error[:frames], axis=0)
        frames *= 4
    yield len(error), np.nanmean(error, axis=0)
