"""Choice of the actuator that turns a measured eye, and accuracy of reading times."""

import numpy as np
import pytest

from tests.hardware.virtual import VirtualRobot, WatchedWorld, virtual_config
from vergence.errors import ConfigurationError
from vergence.hardware.delay.measure import actuator_slot, measure_loop
from vergence.hardware.delay.samples import SampleCollector
from vergence.hardware.emulator.world import MotorOptions
from vergence.models.files.head_file import load_head

TURRETS = load_head("turrets")


def name_of(head, slot):
    return head.actuation.names[slot - 3]


def test_an_eye_is_turned_by_what_moves_its_own_image():
    assert [name_of(TURRETS, actuator_slot(TURRETS, eye)) for eye in (0, 1)] == [
        "left_pan",
        "right_pan",
    ]
    assert name_of(TURRETS, actuator_slot(TURRETS, 1, "right_tilt")) == "right_tilt"


@pytest.mark.parametrize("name", ["right_pan", "left_roll", ""])
def test_an_actuator_that_does_not_turn_the_eye_is_refused(name):
    with pytest.raises(ConfigurationError, match="left_pan or left_tilt, got"):
        actuator_slot(TURRETS, 0, name)


def test_an_actuator_that_eyes_share_turns_both():
    head = load_head("icub")
    shared = {actuator_slot(head, eye, name) for eye in (0, 1) for name in ("eyes_tilt",)}
    assert len(shared) == 1


def test_a_reading_is_dated_to_within_its_exchange():
    now = iter(np.arange(50.0) + 0.003)
    collector = SampleCollector(lambda: next(now))
    for at_s in range(50):  # measured within 3 ms
        collector.joints(float(at_s), np.zeros(7), np.zeros(7))
    late_s = np.random.default_rng(0).uniform(0.0, 0.003, 10_000)
    assert collector.samples("left", 3, 0.0).joint_time_sigma_s == pytest.approx(
        np.sqrt(np.mean(late_s**2)), rel=0.02
    )


@pytest.mark.slow  # a minute of a robot
def test_friction_is_not_taken_for_play_or_latency():
    motors = MotorOptions(friction=0.05, gravity=0.1, command_latency_s=0.01)
    world = WatchedWorld(TURRETS, np.array([0.0, -0.1, 1.0]), motors, latency_s=0.07)
    with pytest.MonkeyPatch.context() as patch:
        robot = VirtualRobot(patch, world, virtual_config(TURRETS, latency_s=0.08))
        found = measure_loop(
            robot.config, ("left",), actuator="left_tilt", clock=robot.clock,
            sleep=robot.clock.sleep,
        )  # fmt: skip
    (eye,) = found.eyes
    assert eye.image_fit.least_latency_s == pytest.approx(0.07, abs=1e-3)
    assert eye.image_fit.backlash_rad < 3e-4
    assert eye.image_fit.jitter_s < 1.5e-3
    assert eye.joint_fit.motor.latency_s == pytest.approx(0.01, abs=2e-3)
    assert found.misfits() == []
