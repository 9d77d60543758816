"""What both eyes have told becomes one loop, and what they cannot tell is said."""

from dataclasses import replace

import pytest

from vergence.hardware.delay.image_fit import ImageFit
from vergence.hardware.delay.joint_fit import JointFit, Motor
from vergence.hardware.delay.measurement import EyeLoop, LoopMeasurement

FIT = JointFit(
    motor=Motor(latency_s=0.01, lag_s=0.03, gain=0.9, per_acceleration=1.0 / 20.0),
    sigma=Motor(latency_s=1e-3, lag_s=1e-3, gain=1e-3, per_acceleration=1e-4),
    greatest_rad_s2=20.0, residual_rad=1e-3, limited=True, correlation=-0.5,
)  # fmt: skip
IMAGE = ImageFit(
    latency_s=0.07, latency_sigma_s=1e-4, jitter_s=0.0, jitter_sigma_s=1e-4, backlash_rad=0.0,
    backlash_sigma_rad=1e-5, residual_px=0.2, scale=1.04, scale_sigma=0.003, images=500,
)  # fmt: skip
EYE = EyeLoop(
    eye="left", actuator="left_pan", lag_ratio=1.5, modelled_rad_s2=40.0, joint=FIT, image=IMAGE,
    computing_s=0.003,
)  # fmt: skip


def test_lag_and_acceleration_are_those_of_the_whole_head():
    loop = LoopMeasurement(eyes=(EYE,)).loop()
    assert loop.lag_s == pytest.approx(0.02)  # the actuator's own is 1.5 times the head's
    assert loop.sigma["lag_s"] == pytest.approx(1e-3 / 1.5)
    assert loop.acceleration_ratio == pytest.approx(0.5)


def test_a_latency_that_a_lag_may_stand_for_is_said():
    assert not any("told badly" in line for line in LoopMeasurement(eyes=(EYE,)).untold())
    together = replace(EYE, joint=replace(FIT, correlation=-0.95))
    (line,) = (line for line in LoopMeasurement(eyes=(together,)).untold() if "told badly" in line)
    assert line.startswith("left_pan: command latency and lag")
    assert "correlation -0.95" in line


def test_what_the_model_does_not_have_is_said():
    assert LoopMeasurement(eyes=(EYE,)).doubts() == []
    swinging = replace(EYE, joint=replace(FIT, residual_rad=8e-3))
    (line,) = LoopMeasurement(eyes=(swinging,)).doubts()
    assert line.startswith("left_pan: its angles are 8.0 mrad (rms) beside")
    shorter = replace(EYE, image=replace(IMAGE, scale=0.9))
    (line,) = LoopMeasurement(eyes=(shorter,)).doubts()
    assert "the image moves by 10 % less" in line
