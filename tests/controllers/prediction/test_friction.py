"""Rest of laws on joints with friction: the emulated robot, and the hold of one actuator."""

from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks.friction import BAND_PX, SETTLE_S, errors_px
from vergence.controllers.prediction.oscillation import error_to_correct
from vergence.hardware.emulator.world import MotorOptions

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


def test_an_error_of_what_may_be_backlash_is_corrected_as_usual():
    actuator = Actuator()
    actuator.corrected_px(0.4, seconds=0.3)
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
    error = errors_px(law, MotorOptions(friction=0.05), 2, "turrets")
    assert np.flatnonzero(error > BAND_PX)[-1] < SETTLE_S * 60.0
