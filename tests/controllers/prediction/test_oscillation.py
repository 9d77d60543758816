"""Eyes that do not rest: half swings that are counted, and the hold of joints with friction."""

from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks.friction import BAND_PX, SETTLE_S, errors_px
from vergence import load_head
from vergence.controllers.prediction.oscillation import (
    OSCILLATING_HALF_SWINGS,
    OscillationState,
    decay_count,
    error_to_correct,
    reset_oscillation,
    update_oscillation,
)
from vergence.controllers.prediction.parameters import (
    PREDICTOR_PARAMETERS,
    pack_predictor_parameters,
)
from vergence.hardware.emulator.config import EmulatorConfig
from vergence.kernels import row_layout

HEAD = load_head("physical")
RATE_HZ = HEAD.timing.control_rate_hz
TIME_S = np.arange(round(2.0 * RATE_HZ)) / RATE_HZ
NOISE = 1e-8
MANY = np.nextafter(OSCILLATING_HALF_SWINGS, np.inf)


def swings(angle, aim=None):
    """The greatest number of swings of a joint at some angles, its goal at others."""
    record = np.zeros(1, dtype=row_layout(OscillationState))[0]
    record["decay_time_s"] = 1.0
    params = pack_predictor_parameters(HEAD).view(PREDICTOR_PARAMETERS)[0]
    reset_oscillation(record, 0, 1, float(angle[0]))
    most = 0.0
    for one, goal in zip(angle, np.zeros_like(angle) if aim is None else aim, strict=True):
        decay_count(record, params.period_s)
        update_oscillation(record, params, 0, 1, float(one), float(goal), NOISE)
        most = max(most, float(record["half_swing_count"]))
    return most


SINE, LATE_SINE = (np.sin(4.0 * np.pi * (TIME_S - late_s)) for late_s in (0.0, 0.02))
MOTIONS = {
    "slow swing": (0.02 * SINE[TIME_S < 1.5], None, MANY, np.inf),
    "swing": (0.02 * np.sin(10.0 * np.pi * TIME_S[TIME_S < 1.0]), None, MANY, np.inf),
    "dying": (0.3 - 0.3 * np.exp(-12.0 * TIME_S) * np.cos(20.0 * TIME_S), None, 0.0, 0.5),
    "tremor": (0.001 * np.sin(60.0 * TIME_S), None, 0.0, 0.5),
    "creep": (0.02 * np.sin(3.0 * TIME_S), None, 0.0, 0.5),
    "pursuit": (0.1 * LATE_SINE, 0.1 * SINE, 0.0, 0.0),
}
"""Angles of an eye, of its goal, and the least and the greatest number of half swings."""


@pytest.mark.parametrize("motion", MOTIONS)
def test_only_an_eye_that_swings_about_a_goal_at_rest_is_found_in_time(motion) -> None:
    angle, aim, least, most = MOTIONS[motion]
    assert least <= swings(angle, aim) <= most


PERIOD_S = 0.01
PIXEL_RAD = 1e-3
CREEP_RAD_S = 0.01


class Actuator:
    """An actuator with an encoder of 1 mrad, which moves only when it is told to."""

    def __init__(self):
        one, zero = np.ones(1), np.zeros(1)
        self.params = SimpleNamespace(
            angle_step=1e-3 * one, speed_step=0.02 * one, period_s=PERIOD_S,
            max_joint_per_actuator=one, pixel_rad=PIXEL_RAD,
        )  # fmt: skip
        arrays = ("angle", "motion_tick", "push", "mode", "step_tick", "step_error")
        self.state = SimpleNamespace(absent_rad=0.0, **{name: zero.copy() for name in arrays})
        self.tick = 0

    def corrected_px(self, error_px, seconds=PERIOD_S, command=CREEP_RAD_S, **options):
        """Error that a law sees after some time at rest, px."""
        values = {"angle": 0.0, "velocity": 0.0, "moves": False, **options}
        for _ in range(round(seconds / PERIOD_S)):
            self.tick += 1
            error, _ = error_to_correct(
                self.state, self.params, self.tick, 0, values["angle"], values["velocity"],
                command, error_px * PIXEL_RAD, values["moves"], 0.03,
            )  # fmt: skip
        return error / PIXEL_RAD


def test_an_actuator_is_held_near_its_goal_once_commanded_motion_is_absent():
    actuator = Actuator()
    assert actuator.corrected_px(0.4, seconds=0.15) == pytest.approx(0.4)
    assert actuator.corrected_px(0.4, seconds=0.1) == 0.0
    assert actuator.corrected_px(0.4, moves=True) == pytest.approx(0.4)
    # so far it may be backlash
    assert actuator.corrected_px(1.0) == pytest.approx(1.0)


def test_friction_is_overcome_in_a_step_that_ends_with_the_motion():
    actuator = Actuator()
    actuator.corrected_px(0.4, seconds=1.0)
    assert actuator.corrected_px(1.0) == pytest.approx(2.0)
    broken = {"angle": 1e-3, "velocity": 0.05}
    assert actuator.corrected_px(0.5, **broken) == pytest.approx(-2.0)
    assert actuator.corrected_px(0.5, angle=1e-3) == 0.0
    assert actuator.corrected_px(1.0, angle=1e-3) == 0.0
    assert actuator.corrected_px(1.0, seconds=0.3, angle=1e-3) == pytest.approx(2.0)


def test_a_joint_that_follows_its_commands_is_never_held():
    actuator = Actuator()
    for n in range(400):
        moved = CREEP_RAD_S * PERIOD_S * n
        assert actuator.corrected_px(0.4, angle=1e-3 * round(1e3 * moved)) == pytest.approx(0.4)


@pytest.mark.nightly
@pytest.mark.parametrize("law", ["saccade", "state-feedback"])
def test_a_law_comes_to_rest_on_joints_with_friction(law, monkeypatch):
    monkeypatch.setattr("benchmarks.friction.STAY_S", 2.0)
    error = errors_px(law, EmulatorConfig(friction=0.05), 2, "turrets")
    assert np.flatnonzero(error > BAND_PX)[-1] < SETTLE_S * 60.0
