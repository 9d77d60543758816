"""Trials made from a recording of any plant, simulated or real."""

import numpy as np

from vergence.envs.plant import Simulation
from vergence.envs.plants.conditions import PER_ACTUATOR, PER_TRIAL
from vergence.envs.streams import IntArray
from vergence.envs.task import GazeTask
from vergence.eval.trials.results import BAND_PX, Trials
from vergence.eval.trials.settling import bands_with_bound
from vergence.models.parts import EYES, FloatArray
from vergence.recording import Recorder
from vergence.triangulation import triangulate_views


def trials_from_record(
    task: GazeTask,
    record: Recorder,
    steps: int,
    *,
    scenario: str,
    plant: str,
    target_moves: bool = False,
    band_px: float = BAND_PX,
    catch_up_s: float = 0.0,
) -> Trials:
    """Make trials of a recording; their onset is at 0 and their bounds are nan.

    Without ground truth the errors are measured ones, at the times of their exposures. The last
    errors are known only if the recording goes on for the latency of an image.

    Args:
        task: the recorded task, open or closed.
        record: a recording with the readings `visible`, `positions` and `command`, and the ground
            truth `pixel_error`, `target` and `motors`; with all fields if the plant is no
            simulation. It may have ended early.
        steps: greatest number of control periods to evaluate.
        scenario: name of the scenario.
        plant: name of the plant.
        target_moves: True if the target keeps moving.
        band_px: leading band of settling, px.
        catch_up_s: time at the start that does not count in tracking, s.

    Returns:
        The trials, without observations and the duration of `predict`.
    """
    head, reading, truth = task.head, record.reading, record.truth
    rows = _rows(task, record, steps)
    positions = reading.positions[rows]
    count = len(positions)
    if truth is None:
        error, driven = _measured_error(task, record, count), positions
        target = np.full((count, task.num, 3), np.nan)
    else:
        error, target = truth.pixel_error[rows], truth.target[rows]
        # The joint angles by the motors, as without backlash: motors that oscillate within the
        # backlash wear the gears although the joints rest.
        driven = head.actuation.joints_of(truth.motors[rows])
    residual = np.zeros((task.num, 2, 2))
    if not isinstance(task.plant, Simulation):
        error = _carried_on(error)
        if not (target_moves or head.actuation.direct):
            views = triangulate_views(head, reading.positions_at_exposure[-1], reading.pixels[-1])
            residual = head.least_error(views.point)
    return Trials(
        scenario=scenario,
        plant=plant,
        target_moves=target_moves,
        band_px=band_px,
        catch_up_s=catch_up_s,
        head=head,
        onset_s=np.zeros(task.num),
        time_s=np.arange(count, dtype=np.float64) * float(head.timing.period_s),
        error=error,
        residual=residual,
        command=reading.command[rows][1:, :, EYES],
        visible=reading.visible[rows],
        lost=np.logical_or.reduce(record.lost[rows]),
        stopped_for_swinging=np.zeros(task.num, dtype=np.bool_),
        positions=positions,
        speed=np.diff(driven[..., EYES], axis=0) / float(head.timing.period_s),
        target=target,
        bounds_s={band.px: np.full(task.num, np.nan) for band in bands_with_bound(band_px)},
        conditions=_conditions(task),
        observation=np.empty((count - 1, 0, task.layout.size), np.float32),
        predict_us=np.nan,
    )


def _rows(task: GazeTask, record: Recorder, steps: int) -> slice | IntArray:
    """Recorded rows of the control periods; a period that a robot missed takes the row before."""
    if isinstance(task.plant, Simulation):
        return slice(steps + 1)
    ends = np.rint(record.reading.time_s[:, 0] * task.head.timing.control_rate_hz)
    periods = np.arange(min(steps, int(ends[-1])) + 1)
    return np.searchsorted(ends, periods, side="right") - 1


def _measured_error(task: GazeTask, record: Recorder, rows: int) -> FloatArray:
    """(rows, n, 2, 2) measured errors at the steps of their exposures; nan between images."""
    exposed = record.reading.exposure_s * task.head.timing.control_rate_hz
    known = np.isfinite(exposed) & (exposed > -0.5)
    step = np.rint(np.where(known, exposed, 0.0)).astype(np.int64)
    told, places = np.nonzero(known & (step < rows))
    measured = record.pixel_error[told, places]
    error = np.full((rows, task.num, 2, 2), np.nan)
    # inf marks a target that was not detected, so that no earlier error is carried on; of two
    # images at one step, the later counts
    error[step[told, places], places] = np.where(np.isnan(measured), np.inf, measured)
    return error


def _carried_on(error: FloatArray) -> FloatArray:
    """Fill periods without an image from the image before; before the first image, from it."""
    error = error.copy()
    for step in range(1, len(error)):
        gap = np.isnan(error[step])
        error[step][gap] = error[step - 1][gap]
    for step in range(len(error) - 2, -1, -1):
        gap = np.isnan(error[step])
        error[step][gap] = error[step + 1][gap]
    error[np.isinf(error)] = np.nan
    return error


def _conditions(task: GazeTask) -> dict[str, FloatArray]:
    """Hidden conditions of the trials by name; empty if the plant is no simulation.

    A condition that each actuator has of its own becomes one entry per actuator of the eyes.
    """
    if not isinstance(task.plant, Simulation):
        return {}
    conditions = task.plant.conditions
    found = {name: getattr(conditions, name).copy() for name in PER_TRIAL}
    for name in PER_ACTUATOR:
        of_eyes = getattr(conditions, name)[:, EYES]
        for j, actuator in enumerate(task.head.actuation.names):
            found[f"{name}_{actuator}"] = of_eyes[:, j].copy()
    return found
