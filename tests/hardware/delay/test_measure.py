"""Choice of the actuator that turns a measured eye, and accuracy of reading times."""

import numpy as np
import pytest

from tests.hardware.virtual import VirtualRobot, WatchedWorld, virtual_config
from tests.naming import named
from vergence.errors import ConfigurationError
from vergence.hardware.delay.measure import actuator_slot, measure_loop
from vergence.hardware.delay.samples import SampleCollector
from vergence.hardware.emulator.config import EmulatorConfig
from vergence.models.head_file import load_head

TURRETS = load_head("turrets")


def test_an_eye_is_turned_by_what_moves_its_own_image():
    # left_pan, left_tilt, right_pan, right_tilt
    assert [actuator_slot(TURRETS, eye) for eye in (0, 1)] == [3, 5]
    assert actuator_slot(TURRETS, 1, "right_tilt") == 6
    for name in ("right_pan", "left_roll", ""):
        with named(name), pytest.raises(ConfigurationError, match="left_pan or left_tilt, got"):
            actuator_slot(TURRETS, 0, name)
    icub = load_head("icub")
    assert actuator_slot(icub, 0, "eyes_tilt") == actuator_slot(icub, 1, "eyes_tilt") == 3


def test_a_reading_is_dated_to_within_its_exchange():
    now = iter(np.arange(50.0) + 0.003)
    collector = SampleCollector(lambda: next(now))
    for at_s in range(50):  # measured within 3 ms
        collector.joints(float(at_s), np.zeros(7), np.zeros(7))
    late_s = np.random.default_rng(0).uniform(0.0, 0.003, 10_000)
    sigma_s = collector.samples("left", 3, 0.0).joint_time_sigma_s
    assert sigma_s == pytest.approx(np.sqrt(np.mean(late_s**2)), rel=0.02)


def measured(monkeypatch, motors, actuator):
    """The loop of the left eye of a robot whose images are 70 ms late."""
    world = WatchedWorld(TURRETS, np.array([0.0, -0.1, 1.0]), motors, latency_s=0.07)
    robot = VirtualRobot(monkeypatch, world, virtual_config(TURRETS, latency_s=0.08))
    return measure_loop(
        robot.config, ("left",), actuator=actuator, clock=robot.clock, sleep=robot.clock.sleep,
        view_check=actuator is not None,
    )  # fmt: skip


@pytest.mark.slow
def test_a_loop_is_found_in_the_motion_of_one_eye(monkeypatch):
    motors = EmulatorConfig(command_latency_s=0.01, speed_gain=0.9, backlash_rad=0.004)
    (eye,) = measured(monkeypatch, motors, None).eyes
    assert eye.actuator == "left_pan"
    assert eye.image_fit.least_latency_s == pytest.approx(0.07, abs=2e-3)
    assert eye.image_fit.backlash_rad == pytest.approx(0.004, abs=5e-4)
    assert eye.joint_fit.motor.latency_s == pytest.approx(0.01, abs=2e-3)
    assert eye.joint_fit.motor.gain == pytest.approx(0.9, abs=0.01)


@pytest.mark.nightly
def test_friction_is_not_taken_for_play_or_latency(monkeypatch):
    motors = EmulatorConfig(friction=0.05, gravity=0.1, command_latency_s=0.01)
    found = measured(monkeypatch, motors, "left_tilt")
    (eye,) = found.eyes
    assert eye.image_fit.least_latency_s == pytest.approx(0.07, abs=1e-3)
    assert eye.image_fit.backlash_rad < 3e-4
    assert eye.image_fit.jitter_s < 1.5e-3
    assert eye.joint_fit.motor.latency_s == pytest.approx(0.01, abs=2e-3)
    assert found.misfits() == []
