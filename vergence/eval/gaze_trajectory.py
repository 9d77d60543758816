"""The table of a gaze's trial, one row per control period, from a recording alone."""

import csv
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from vergence.envs.reading import Reading, Truth
from vergence.models.head import HeadModel
from vergence.models.parts import EYE_NAMES, EYES, FloatArray
from vergence.recording import Recorder
from vergence.triangulation import Fix, triangulate_gaze, triangulate_views

Trajectory = Mapping[str, NDArray[Any]]
"""Columns of a table by name; pandas, which a gaze does not need, takes 0.4 s to import."""
MM: Final = 1000.0
"""Millimetres per metre (physical: conversion of units)."""
_MOST_IMAGE_AGE_S: Final = 0.2
"""Greatest age of the last image with the target visible in both eyes for it to be used, s
(chosen)."""


def reading_of_first_head(record: Recorder) -> Reading:
    """Readings of a recording's first head, without the axis of the heads."""
    return Reading._make(part[:, 0] for part in record.reading)


def truth_of_first_head(record: Recorder) -> Truth:
    """Ground truth of a recording's first head; nan, and nothing in view, if unknown."""
    if record.truth is None:
        return Truth.unknown(len(record.reading.time_s))
    return Truth._make(part[:, 0] for part in record.truth)


def gaze_and_view_fixes(head: HeadModel, record: Recorder) -> tuple[Fix, Fix]:
    """Triangulate the target of a recording's first head in each control period.

    Args:
        head: the model.
        record: a recording with all fields of the readings.

    Returns:
        (rows,) fixes by gaze, from the joint angles; and (rows,) fixes from the last image, not
        older than 0.2 s, with the target visible in both eyes, and the joint angles of its
        exposure.
    """
    reading = reading_of_first_head(record)
    views = triangulate_views(head, reading.positions_at_exposure, reading.pixels)
    # without synchronised cameras, the newest image may be of one eye only
    rows = _last_valid(reading.time_s, views.valid)
    return triangulate_gaze(head, reading.positions), Fix._make(part[rows] for part in views)


def _last_valid(time_s: FloatArray, valid: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Row whose fix each row takes: the last valid one, or its own if that one is too old."""
    rows = np.zeros(len(valid), dtype=np.int64)
    last = 0
    for row in range(len(valid)):
        if valid[row] or time_s[row] - time_s[last] > _MOST_IMAGE_AGE_S:
            last = row
        rows[row] = last
    return rows


def trajectory_of_first_head(head: HeadModel, record: Recorder) -> Trajectory:
    """Tabulate a recording's first head: its pixels, joints, commands and fixes.

    Args:
        head: the model that the controller knew.
        record: a recording with all fields of the readings, and of the ground truth if known.

    Returns:
        Columns with one row per control period; nan for unknown ground truth.
    """
    reading, truth = reading_of_first_head(record), truth_of_first_head(record)
    columns: dict[str, NDArray[Any]] = {"time_s": reading.time_s, "exposure_s": reading.exposure_s}
    by_eye = {
        "pixel": reading.pixels,
        "measured_error": record.pixel_error[:, 0],
        "true_pixel": truth.pixels,
        "true_error": truth.pixel_error,
    }
    for eye, name in enumerate(EYE_NAMES):
        columns[f"visible_{name}"] = reading.visible[:, eye]
        for axis, axis_name in enumerate("uv"):
            for what, pixels in by_eye.items():
                columns[f"{what}_{name}_{axis_name}_px"] = pixels[:, eye, axis]
    for joint, name in enumerate(head.joints):
        if name:  # a joint shared by both eyes occurs twice, with the same angle
            columns[f"position_{name}_rad"] = reading.positions[:, joint]
            columns[f"velocity_{name}_rad_s"] = reading.velocities[:, joint]
    for name, velocity in zip(head.actuation.names, reading.command[:, EYES].T, strict=False):
        columns[f"command_{name}_rad_s"] = velocity
    for method, fix in zip(("gaze", "itpc"), gaze_and_view_fixes(head, record), strict=True):
        for axis, name in enumerate("xyz"):
            columns[f"{method}_{name}_mm"] = MM * fix.point[:, axis]
        columns[f"{method}_gap_mm"] = MM * fix.gap
    return columns


def write_trajectory(trajectory: Trajectory, path: Path) -> None:
    """Write a trajectory as CSV; nan is an empty cell, and other numbers are read back exactly."""
    # to Python's numbers first, whose text is the shortest that is exact
    columns = [[None if v != v else v for v in column.tolist()] for column in trajectory.values()]
    with path.open("w", encoding="utf-8", newline="") as file:
        rows = csv.writer(file, lineterminator=os.linesep)
        rows.writerow(trajectory)
        rows.writerows(zip(*columns, strict=True))
