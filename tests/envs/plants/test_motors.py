"""Motors of heads whose joints are tied: lags, limits, encoder steps and play of their own."""

import dataclasses

import numpy as np
import pytest

from tests.envs.trials import begin, start_of, steps
from tests.heads import MOVING, head_of, text_of
from tests.naming import named
from vergence.envs.plants.kinematic import KinematicPlant
from vergence.envs.plants.motors import MotorStates
from vergence.errors import ConfigurationError
from vergence.models import HeadModel, parse_head
from vergence.models.motion import follow_joint, lag_decay

PERIOD_S = 1.0 / 120.0


def tied(**fields: object) -> HeadModel:
    """The head `tied` with exact sensors and other numbers of its three actuators."""
    head = head_of("tied").replace(
        sensor={"encoder_resolution_rad": 0.0, "velocity_resolution_rad_s": 0.0}
    )
    return dataclasses.replace(head, actuators=dataclasses.replace(head.actuators, **fields))


def command(*rates: float) -> np.ndarray:
    out = np.zeros(7)
    out[3 : 3 + len(rates)] = rates
    return out


def test_tied_joints_move_as_their_actuators_say() -> None:
    head = tied()
    _r, q, v = steps(KinematicPlant(head), start_of(), 40, command(0.5, 1.0, 0.4))
    # a common tilt turns both eyes; version and half the vergence add up on the left
    assert np.array_equal(q[:, 0, 3], q[:, 0, 5])
    assert q[-1, 0, 4] > q[-1, 0, 6] > 0.0
    assert v[-1, 0, 3:] == pytest.approx([0.5, 1.2, 0.5, 0.8], rel=1e-3)
    assert not q[:, 0, :3].any()
    assert head.reaches(q).all()


def test_a_reading_counts_the_encoders_of_the_actuators_and_has_one_error_for_tied_joints() -> None:
    step = np.array([0.01, 0.02, 0.03])
    head = tied(encoder_resolution_rad=step)
    readings, q, _v = steps(KinematicPlant(head), start_of(), 40, command(0.5, 1.0, 0.4))
    read = np.array([one.positions[0] for one in readings])
    error = read - q[:, 0]
    assert np.array_equal(error[:, 3], error[:, 5])
    own = head.actuation.actuators_of(read)[:, 3:6]
    assert own / step == pytest.approx(np.round(own / step), abs=1e-9)
    off = own - head.actuation.actuators_of(q[:, 0])[:, 3:6]
    assert (np.abs(off) <= 0.5 * step + 1e-12).all()
    assert (np.abs(off).max(axis=0) > 0.2 * step).all()


def test_each_actuator_has_its_own_lag_which_a_trial_scales() -> None:
    head = tied(lag_s=np.array([0.03, 0.06, 0.015]))
    for lag_s, ratio in ((None, 1.0), (0.045, 1.5)):
        plant = KinematicPlant(head, lag_s=lag_s)
        _r, _q, v = steps(plant, start_of(), 10, command(0.1, 0.1, 0.1))
        rates = head.actuation.to_actuators[:3] @ v[-1, 0, 3:]
        lags = ratio * np.array([0.03, 0.06, 0.015])
        assert rates == pytest.approx(0.1 * (1.0 - np.exp(-10 * PERIOD_S / lags)), rel=1e-9)


def test_each_actuator_keeps_its_own_limits() -> None:
    head = tied(
        velocity=np.array([1.0, 2.0, 3.0]), lower=np.array([-0.2, -0.3, 0.0]),
        upper=np.array([0.2, 0.3, 0.5]), acceleration=np.array([10.0, 20.0, 30.0]),
    )  # fmt: skip
    own = head.actuation
    readings, q, v = steps(KinematicPlant(head), start_of(), 90, command(9.0, -9.0, 9.0))
    assert readings[-1].command[0, 3:].tolist() == [1.0, -2.0, 3.0, 0.0]
    assert own.actuators_of(q[-1, 0])[3:6] == pytest.approx([0.2, -0.3, 0.5], abs=1e-12)
    rates = np.abs(v[:, 0, 3:] @ own.to_actuators[:3].T)
    assert (rates <= np.array([1.0, 2.0, 3.0]) + 1e-12).all()
    gains = np.abs(np.diff(rates, axis=0))[:5] / PERIOD_S
    assert (gains <= np.array([10.0, 20.0, 30.0]) + 1e-9).all()


def test_a_joints_own_stop_holds_all_that_push_against_it() -> None:
    text = text_of("tied")
    pan = text.index("[[joints]]", text.index("eyes_tilt"))
    end = text.index("[[joints]]", pan + 1)
    limits = "lower_rad = -0.4\nupper_rad = 0.4\nvelocity_rad_s = 5.0\nacceleration_rad_s2 = 80.0\n"
    head = parse_head(text[:end] + limits + text[end:])
    assert head.limits.upper[4] == 0.4
    _r, q, v = steps(KinematicPlant(head), start_of(), 120, command(0.0, 1.0, 1.0))
    assert q[:, 0, 4].max() == pytest.approx(0.4, abs=1e-12)
    assert v[-1, 0, 4] == pytest.approx(0.0, abs=1e-9)
    # and lets go at once
    plant = KinematicPlant(head)
    steps(plant, start_of(), 120, command(0.0, 1.0, 1.0))
    for _ in range(30):
        plant.step(command(0.0, -1.0, 0.0)[None])
    assert plant.truth().positions[0, 4] < 0.35


def test_what_a_motor_drives_is_left_where_it_turned_round_within_a_period() -> None:
    head = tied(backlash_rad=np.array([0.05, 0.0, 0.0]), lag_s=np.array([0.01, 0.03, 0.03]))
    plant = KinematicPlant(head)
    begin(plant, start_of())
    for _ in range(60):
        plant.step(command(0.6)[None])
    motors = plant._motors
    q, v = motors.angles[0, 3], motors.speeds[0, 3]
    plant.step(command(-0.9)[None])
    times = np.linspace(0.0, PERIOD_S, 2001)
    path = [follow_joint(q, v, -0.9, 0.01, 80.0, t, lag_decay(t, 0.01))[0] for t in times]
    assert max(path) > max(path[0], path[-1]) + 1e-5
    assert plant.truth().positions[0, 3] == pytest.approx(max(path) - 0.025, abs=1e-9)


def test_a_trial_begins_where_the_actuators_can_be() -> None:
    for name in MOVING:
        with named(name):
            head = head_of(name)
            plant = KinematicPlant(head)
            goal = head.fixate([0.02, 0.01, 0.9])
            goal[:3] = [0.0 if missing == "" else 0.05 for missing in head.joints[:3]]
            asked = goal.copy()
            asked[[not joint for joint in head.joints]] = 0.7  # of joints that there are not
            reading = begin(plant, start_of(positions=asked))
            assert plant.truth().positions[0] == pytest.approx(goal, abs=1e-12)
            assert not plant.truth().velocities.any()
            motors = MotorStates.of(head, head, 1).angles[0]
            assert head.actuation.joints_of(motors) == pytest.approx(head.rest(), abs=1e-12)
            steps_off = np.abs(reading.positions[0] - goal)
            assert steps_off.max() <= 0.00051


def test_the_neck_of_a_tied_head_moves_too() -> None:
    head = tied()
    rates = np.zeros(7)
    rates[:3] = [0.2, -0.1, 0.3]
    _r, q, v = steps(KinematicPlant(head), start_of(), 60, rates)
    assert v[-1, 0, :3] == pytest.approx(rates[:3], rel=1e-4)
    assert not q[:, 0, 3:].any()


def test_a_true_head_with_other_actuators_is_refused() -> None:
    with pytest.raises(ConfigurationError, match=r"true_head: expected actuators .* \(tilt, ver"):
        KinematicPlant(head_of("tied"), true_head=head_of("common"))
