"""The predictor: the present error from old images, and the delay that explains them."""

import numpy as np
import pytest

from tests.controllers.loops import begin
from tests.controllers.reaching import run
from vergence import load_head
from vergence.controllers.prediction.predictor import HOLD_S, Predictor
from vergence.envs.layout import ObservationLayout
from vergence.envs.task import GazeTask
from vergence.errors import ConfigurationError

QUIET = {"detection_noise_px": 0.0}


def quiet_head(name="simulated"):
    return load_head(name).replace(sensor=QUIET)


@pytest.mark.parametrize("name", ["saccade", "delay-compensated"])
def test_without_noise_the_prediction_is_the_truth_while_the_eyes_move(name) -> None:
    task = GazeTask(20, head=quiet_head(), plant="kinematic")
    trial = run(task, name, 60)
    known = np.array([p.known for p in trial.predicted])
    assert known[8:].all()
    assert not known[:8].any()
    predicted = np.array([p.pixel_error for p in trial.predicted])
    miss = np.linalg.norm(predicted[8:] - trial.errors[8:-1], axis=-1)
    # float32 observations and the end of Newton's method leave thousandths of a pixel; a
    # frame dated wrongly by one period would leave 31 px at full speed
    assert np.linalg.norm(np.diff(trial.errors, axis=0), axis=-1).max() > 10.0
    assert miss.max() < 0.02


def test_what_is_left_to_turn_ends_where_both_eyes_fixate() -> None:
    task = GazeTask(20, head=quiet_head(), plant="kinematic")
    trial = run(task, "saccade", 20)
    truth = task.truth()
    goal = task.head.fixate(truth.target, task.head.rest()[:3])[:, 3:]
    last = trial.predicted[-1]
    assert np.abs(last.positions + last.to_go - goal).max() < 2e-5  # 0.01 px


@pytest.mark.parametrize("delay", [4, 6, 8, 10, 12, 15])
@pytest.mark.parametrize("drop", [0.0, 0.1])
def test_one_saccade_tells_the_delay(delay, drop) -> None:
    task = GazeTask(
        12,
        plant="kinematic",
        plant_options={"latency_s": delay / 120.0, "dropped_frame_probability": drop},
    )
    trial = run(task, "saccade", 50)
    found = np.array([p.delay_s for p in trial.predicted]) * 120.0
    assert np.allclose(found[0], 8.0)  # it begins with the nominal one
    np.testing.assert_allclose(found[-1], delay, atol=1e-6)


def test_images_of_an_unknown_delay_do_not_lead_a_saccade_astray() -> None:
    for delay in (4, 15):
        task = GazeTask(
            12, head=quiet_head(), plant="kinematic", plant_options={"latency_s": delay / 120.0}
        )
        trial = run(task, "saccade", 60)
        goals = np.array([p.positions + p.to_go for p in trial.predicted])[delay:]
        # the first image shows eyes at rest, which no delay makes wrong; 1 mrad is 0.6 px
        assert np.abs(goals - goals[0]).max() < 1e-3


def test_known_timing_is_never_doubted() -> None:
    task = GazeTask(300, plant="kinematic")
    trial = run(task, "saccade", 60)
    assert (np.array([p.delay_s for p in trial.predicted]) == trial.predicted[0].delay_s[0]).all()


@pytest.mark.parametrize("lag_s", [0.015, 0.03, 0.06])
def test_a_saccade_tells_the_joints_lag(lag_s) -> None:
    task = GazeTask(12, plant="kinematic", plant_options={"lag_s": lag_s})
    trial = run(task, "saccade", 60)
    # a short one may stay at the acceleration limit, which only bounds the lag
    assert np.abs(trial.predicted[-1].lag_s / lag_s - 1.0).max() < 0.1
    assert np.abs(trial.predicted[-1].lag_s / lag_s - 1.0).mean() < 0.02


def test_angles_between_the_steps_of_the_encoders_are_followed() -> None:
    head = load_head("physical")
    task = GazeTask(30, head=head, plant="kinematic")
    trial = run(task, "saccade", 40)
    tracked = np.array([p.positions for p in trial.predicted])[8:]
    moving = trial.positions[8:-1, :, 3:]
    start = (tracked[0] - moving[0])[None]
    step = head.sensor.encoder_resolution_rad
    rounded = step * np.round(moving / step)
    # the offset at rest cannot be seen; what is added on the way is less than what rounding adds
    added, rounding = tracked - moving - start, rounded - moving - start
    assert added.std() < 0.75 * rounding.std()
    assert np.abs(tracked - moving).max() < 0.51 * step


def test_a_target_that_is_lost_is_held_for_a_while_then_forgotten() -> None:
    head = quiet_head()
    layout = ObservationLayout.of(head)
    predictor = Predictor(head=head, layout=layout)
    task = GazeTask(1, head=head, plant="kinematic")
    begin(task)
    state = np.tile(predictor.initial(), (1, 1))
    for _ in range(12):
        seen = predictor.update(layout.decode(task.observation), state)
        task.step(np.zeros((1, 4)))
    assert seen.known.all()
    blind = layout.decode(task.observation)
    blind = blind._replace(pixel_error=np.full((1, 2, 2), np.nan))
    hold = round(HOLD_S * 120)
    for _ in range(hold):
        held = predictor.update(blind, state)
    np.testing.assert_allclose(held.to_go, seen.to_go)
    lost = predictor.update(blind, state)
    assert not lost.known.any()
    assert (lost.to_go == 0.0).all()
    assert np.isnan(lost.pixel_error).all()


def test_a_jump_of_the_target_is_followed_at_its_first_image() -> None:
    target = {"kind": "step", "before": (0.0, -0.1, 1.0), "after": (0.1, -0.2, 0.9)}
    task = GazeTask(1, head=quiet_head(), plant="kinematic", target=target)
    trial = run(task, "saccade", 12)
    goals = np.array([(p.positions + p.to_go)[0] for p in trial.predicted])
    goal = task.head.fixate(np.array(target["after"]), task.head.rest()[:3])[3:]
    assert np.abs(goals[7] - goal).max() > 0.05
    assert np.abs(goals[8] - goal).max() < 2e-3


def test_options_that_cannot_be_are_refused() -> None:
    head = load_head("simulated")
    layout = ObservationLayout.of(head)
    with pytest.raises(ConfigurationError, match="delay: expected"):
        Predictor(head=head, layout=layout, delay="known")
    slow = head.replace(timing={"latency_s": 21 / head.timing.control_rate_hz})
    with pytest.raises(ConfigurationError, match="at most 20 control periods, got 21"):
        Predictor(head=slow, layout=ObservationLayout.of(slow))
