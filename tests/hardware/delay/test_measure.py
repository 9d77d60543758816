"""Choice of the actuator that turns a measured eye, and accuracy of reading times."""

from dataclasses import replace

import numpy as np
import pytest

from tests.hardware.virtual import VirtualRobot, WatchedWorld, virtual_config
from tests.naming import named
from vergence.errors import ConfigurationError
from vergence.hardware.delay.image_fit import ImageFit
from vergence.hardware.delay.joint_fit import FittedMotor, JointFit, jackknife_covariance
from vergence.hardware.delay.measure import (
    EyeLoop,
    LoopMeasurement,
    SampleCollector,
    actuator_slot,
    measure_loop,
)
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


FIT = JointFit(
    motor=FittedMotor(latency_s=0.01, lag_s=0.03, gain=0.9, inverse_acceleration=1.0 / 20.0),
    sigma=FittedMotor(latency_s=1e-3, lag_s=1e-3, gain=1e-3, inverse_acceleration=1e-4),
    peak_acceleration_rad_s2=20.0, lag_s=0.03,
    lag_sigma_s=1e-3, misfit_rad=1e-3, acceleration_limited=True,
    latency_lag_correlation=-0.5,
)  # fmt: skip
IMAGE = ImageFit(
    latency_s=0.07, latency_sigma_s=1e-4, jitter_s=0.0, jitter_sigma_s=1e-4, backlash_rad=0.0,
    backlash_sigma_rad=1e-5, residual_px=0.2, scale=1.04, scale_sigma=0.003, images=500,
)  # fmt: skip
EYE = EyeLoop(
    eye="left", actuator="left_pan", lag_ratio=1.5, model_acceleration_rad_s2=40.0, joint_fit=FIT,
    image_fit=IMAGE,
    computing_s=0.003,
)  # fmt: skip


def test_lag_and_acceleration_are_those_of_the_whole_head():
    loop = LoopMeasurement(eyes=(EYE,)).loop()
    assert loop.lag_s == pytest.approx(0.02)  # the actuator's own is 1.5 times the head's
    assert loop.sigma["lag_s"] == pytest.approx(1e-3 / 1.5)
    assert loop.acceleration_ratio == pytest.approx(0.5)


def test_a_jitter_that_was_not_told_is_left_out_and_said():
    slow = replace(EYE, image_fit=replace(IMAGE, jitter_s=None, jitter_sigma_s=np.inf))
    found = LoopMeasurement(eyes=(slow,))
    assert found.loop().jitter_s is None
    assert np.isfinite(list(found.loop().sigma.values())).all()
    assert any("too slowly to measure the jitter" in line for line in found.undetermined())


def test_what_only_the_prior_knows_has_the_priors_deviation():
    data, before = np.array([[2.0, 0.0]] * 40), np.array([[0.0, 5.0]])
    residual = np.append(np.random.default_rng(0).normal(size=40), 0.0)
    rows, blocks = np.concatenate([data, before]), np.arange(40) // 4
    found = jackknife_covariance(rows, residual, blocks, 1e6, 1)
    assert found[1, 1] == pytest.approx(0.2**2)
    assert found[0, 0] == pytest.approx(1.0 / (4.0 * 40), rel=0.6)


def test_a_latency_that_a_lag_may_stand_for_is_said():
    def said(eye):
        lines = LoopMeasurement(eyes=(eye,)).undetermined()
        return [line for line in lines if "poorly separated" in line]

    assert said(EYE) == []
    (line,) = said(replace(EYE, joint_fit=replace(FIT, latency_lag_correlation=-0.95)))
    assert line.startswith("left_pan: command latency and lag")
    assert "correlation -0.95" in line


def test_what_the_model_does_not_have_is_said():
    assert LoopMeasurement(eyes=(EYE,)).misfits() == []
    swinging = replace(EYE, joint_fit=replace(FIT, misfit_rad=8e-3))
    (line,) = LoopMeasurement(eyes=(swinging,)).misfits()
    assert line.startswith("left_pan: its angles are 8.0 mrad (rms) beside")
    shorter = replace(EYE, image_fit=replace(IMAGE, scale=0.9))
    (line,) = LoopMeasurement(eyes=(shorter,)).misfits()
    assert "the image moves by 10 % less" in line


def test_no_camera_is_blamed_for_a_joint_that_moves_otherwise():
    beside = replace(IMAGE, residual_px=1.5)
    (line,) = LoopMeasurement(eyes=(replace(EYE, image_fit=beside),)).misfits()
    assert line.startswith("left eye: its camera")
    swinging = replace(EYE, image_fit=beside, joint_fit=replace(FIT, misfit_rad=8e-3))
    (line,) = LoopMeasurement(eyes=(swinging,)).misfits()
    assert line.startswith("left_pan")


def test_friction_is_told_where_it_is_well_determined():
    def told(sigma_rad_s2):
        motor = FIT.motor._replace(friction_rad_s2=1.0)
        sigma = FIT.sigma._replace(friction_rad_s2=sigma_rad_s2)
        fit = replace(FIT, motor=motor, sigma=sigma)
        rows = LoopMeasurement(eyes=(replace(EYE, joint_fit=fit),)).rows()
        return [row["value"] for row in rows if row["what"] == "friction"]

    assert told(0.05) == [pytest.approx(5.0)]
    assert told(0.5) == []
