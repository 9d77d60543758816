"""Saccade and trim, and the law on predicted errors: fast, within limits, settled to stay."""

import numpy as np
import pytest

from tests.controllers.loops import begin
from tests.controllers.reaching import run
from tests.grids import some_of
from tests.joint_motion import respond
from tests.naming import named
from vergence import load_head, make_controller
from vergence.controllers.prediction.parameters import pack_predictor_parameters
from vergence.controllers.saccade import saccade_command
from vergence.envs.task import GazeTask
from vergence.errors import ConfigurationError
from vergence.eval.trials.metrics import overshoot_fraction, settle_time

PERIOD_S = 1 / 120
KNOWN_WELL = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0]
"""The acceleration as the model has it, latency and detections without doubt."""
TRUSTING = [1.0, 0.0, 0.0, 40.0]
"""A law that brakes with all of the acceleration that it knows of, and does not trim."""


def settled(trial, band_px=1.0):
    return settle_time(np.arange(len(trial.errors)) * PERIOD_S, trial.errors, band_px)


def move(angle_error: float, v: float, periods: int, lag: float = 0.03) -> np.ndarray:
    """(periods + 1, 2) what is left and the velocity of one joint that follows its commands."""
    params = pack_predictor_parameters(load_head("simulated"))
    q, speed = np.zeros((1, 7)), np.zeros((1, 7))
    speed[0, 3] = v
    states = [(angle_error, v)]
    for _ in range(periods):
        command = np.zeros((1, 7))
        command[:, 3:] = saccade_command(
            [[angle_error - q[0, 3], 0.0, 0.0, 0.0]], speed[:, 3:], *np.zeros((3, 1, 4)),
            [[True, True]], [lag], np.ones((1, 4)), KNOWN_WELL, params, TRUSTING,
        )  # fmt: skip
        assert np.abs(command).max() <= 6.0
        q, speed = respond(q, speed, command, lag, 120.0, PERIOD_S)
        states.append((angle_error - q[0, 3], speed[0, 3]))
    return np.array(states)


def test_a_small_angle_takes_two_periods_and_ends_at_rest() -> None:
    for lag, angle_error in some_of([0.015, 0.03, 0.06], [0.002, -0.002, 0.003]):
        with named(lag, angle_error):
            after = move(angle_error, 0.0, 2, lag)[-1]
            assert abs(after[0]) < 1e-9
            assert abs(after[1]) < 1e-6


def test_a_joint_that_could_stop_does_not_pass_its_goal() -> None:
    for v, degrees, lag in some_of([0.0, 2.0, -3.0], [-30.0, -4.0, 7.0, 15.0, 40.0], [0.015, 0.03]):
        with named(v, degrees, lag):
            angle_error = np.radians(degrees)
            motion = move(angle_error, np.sign(angle_error) * v, 60, lag)
            assert abs(motion[-1, 0]) < 1e-6
            assert abs(motion[-1, 1]) < 1e-4
            # a hundredth of a pixel
            assert (motion[:, 0] * np.sign(angle_error)).min() > -1.6e-5


def test_a_joint_stops_as_soon_as_bang_bang_control_could() -> None:
    for degrees, fastest in [(5.0, 0.054), (10.0, 0.077), (20.0, 0.113), (30.0, 0.145)]:
        with named(degrees):
            motion = move(np.radians(degrees), 0.0, 40)
            outside = np.flatnonzero(np.abs(motion[:, 0]) > 1e-3)
            # 1 mrad is passed up to 5 ms before the end; commands change at whole periods, so the
            # switch and the end each wait for one
            assert fastest - PERIOD_S < (outside[-1] + 1) * PERIOD_S < fastest + 2.0 * PERIOD_S


def test_saccades_are_within_a_fifth_of_the_bound() -> None:
    task = GazeTask(120, plant="kinematic")
    trial = run(task, "saccade", 72)
    ratio = settled(trial) / trial.bound_s
    assert np.isfinite(ratio).all()
    assert ratio.min() > 1.0 - 1e-9
    assert np.median(ratio) < 1.1
    assert np.percentile(ratio, 95) < 1.2
    assert np.median(overshoot_fraction(trial.errors)) < 0.02


def test_the_law_on_predicted_errors_bears_more_than_twice_the_articles_gain() -> None:
    task = GazeTask(60, plant="kinematic")
    trial = run(task, "delay-compensated", 120)
    time = settled(trial)
    assert np.isfinite(time).all()
    assert np.median(time) < 0.42
    assert np.median(overshoot_fraction(trial.errors)) < 0.01


@pytest.mark.parametrize("name", ["saccade", "delay-compensated"])
def test_the_physical_head_stays_settled_to_the_trials_end(name) -> None:
    task = GazeTask(30, head="physical", plant="kinematic")
    trial = run(task, name, 240)
    assert np.isfinite(settled(trial)).all()
    # 12-bit steps are 0.8 px; a limit cycle over a step would show
    assert np.linalg.norm(trial.errors[-120:], axis=-1).max() < 0.75


def test_a_saccade_goes_on_while_its_own_speed_blinds_the_eyes() -> None:
    head = load_head("physical")
    task = begin(GazeTask(20, head=head, plant="kinematic"))
    controller = make_controller("saccade", head=head, layout=task.layout)
    state, blind = None, np.zeros(20, dtype=int)
    for _ in range(60):
        action, state = controller.predict(task.observation, state)
        task.step(action)
        blind += np.isnan(task.pixel_error).any(axis=(1, 2)) & np.isfinite(task.reading.exposure_s)
    assert (blind > 3).sum() > 5
    assert np.linalg.norm(task.truth().pixel_error, axis=-1).max() < 1.0


@pytest.mark.parametrize(("delay", "lag_s"), [(4, 0.06), (15, 0.02)])
def test_saccades_settle_with_a_delay_and_a_lag_that_nobody_told(delay, lag_s) -> None:
    options = {"latency_s": delay * PERIOD_S, "lag_s": lag_s}
    options |= {"dropped_frame_probability": 0.1, "detection_noise_px": 0.15}
    errors = {"joint_offset_rad": 0.01, "focal_relative": 0.005, "head_eye_rad": 0.01}
    task = GazeTask(30, plant="kinematic", plant_options=options, model_errors=errors)
    trial = run(task, "saccade", 180)
    assert np.isfinite(settled(trial)).all()


def test_a_state_of_another_batch_is_refused() -> None:
    task = GazeTask(3, plant="kinematic")
    controller = make_controller("saccade", head=task.head, layout=task.layout)
    with pytest.raises(ConfigurationError, match="state: expected a tuple of one array"):
        controller.predict(task.observation, (np.zeros((2, 5)),))
