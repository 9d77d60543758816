"""A loop is found again in samples that a known one has made."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lsim, lti

from vergence.hardware.delay.image_fit import fit_latency_and_backlash
from vergence.hardware.delay.joint_fit import (
    FittedMotor,
    fit_joint,
    fitted_angle_path,
    simulate_motor,
)
from vergence.hardware.delay.measure import drift_corrected_velocities, excitation_speeds
from vergence.models.head_file import load_head

HEAD = load_head("turrets")
PERIOD_S = HEAD.timing.period_s
STEP_RAD = 0.0015339807878856412
SLOT, EYE = 3, 0
POINT = np.array([0.02, -0.1, 1.1])
GUESS = FittedMotor(latency_s=0.0, lag_s=0.03, gain=1.0, inverse_acceleration=1.0 / 80.0)


def samples(motor, seed=0, way=None):
    """Commands a period apart, a little late as in life, and angles as an encoder has them."""
    rng = np.random.default_rng(seed)
    sent = excitation_speeds(0.2, 6.0, PERIOD_S) if way is None else way
    sent_s = PERIOD_S * np.arange(len(sent)) + rng.uniform(0.0, 0.003, len(sent))
    joints_s = sent_s + rng.uniform(0.008, 0.012, len(sent))
    drift = 0.05 * np.sin(0.2 * joints_s)
    angles = simulate_motor(motor, sent_s, sent, joints_s)[0] + drift
    return sent_s, sent, joints_s, STEP_RAD * np.round(angles / STEP_RAD)


@pytest.mark.parametrize("values", [(0.012, 0.045, 0.87, 1.0 / 50.0), (0.03, 0.018, 1.1, 0.025)])
def test_a_motor_is_found_within_its_uncertainty(values):
    motor = FittedMotor(*values)
    found = fit_joint(*samples(motor), GUESS, STEP_RAD)
    assert found.motor == pytest.approx(motor, rel=0.02, abs=5e-4)
    off = (np.array(found.motor[:4]) - np.array(motor[:4])) / np.array(found.sigma[:4])
    assert np.abs(off).max() < 4.5
    assert found.acceleration_rad_s2 == pytest.approx(1.0 / motor.inverse_acceleration, rel=0.02)


@pytest.mark.parametrize(("greatest_rad_s2", "seed"), [(105.0, 0), (105.0, 1), (500.0, 2)])
def test_an_acceleration_that_was_not_reached_is_not_told(greatest_rad_s2, seed):
    strong = GUESS._replace(lag_s=0.05, inverse_acceleration=1.0 / greatest_rad_s2)
    found = fit_joint(*samples(strong, seed), GUESS, STEP_RAD)
    assert found.acceleration_rad_s2 is None
    assert found.motor.lag_s == pytest.approx(0.05, rel=0.02)
    assert 50.0 < found.peak_acceleration_rad_s2 < 105.0


@pytest.mark.nightly
def test_a_servo_that_overshoots_is_beside_a_lag():
    sent_s, sent, joints_s, _ = samples(GUESS)
    times = np.arange(sent_s[0], joints_s[-1], 1e-3)
    asked = sent[np.searchsorted(sent_s, times, side="right") - 1]
    # by 16 %
    servo = lti([30.0**2], [1.0, 30.0, 30.0**2])
    turned = np.interp(joints_s, times, 1e-3 * np.cumsum(lsim(servo, asked, times)[1]))
    turned = STEP_RAD * np.round(turned / STEP_RAD)
    found = fit_joint(sent_s, sent, joints_s, turned, GUESS, STEP_RAD)
    assert found.misfit_rad > 4e-3


@pytest.mark.slow
def test_images_tell_latency_jitter_and_play():
    latency_s, jitter_s, backlash_rad, focal = 0.12, 0.01, 0.003, 0.85
    motor = GUESS._replace(latency_s=0.01, gain=0.95)
    told = samples(motor)
    path = fitted_angle_path(motor, *told)
    rng = np.random.default_rng(1)
    exposed_s = np.arange(0.6, told[2][-1] - 0.2, HEAD.timing.frame_s)
    grid = np.arange(told[2][0], told[2][-1], 0.001)
    angles = simulate_motor(motor, told[0], told[1], grid)[0] + 0.05 * np.sin(0.2 * grid)
    joint, behind = angles[0], []
    for angle in angles:
        joint = np.clip(joint, angle - 0.5 * backlash_rad, angle + 0.5 * backlash_rad)
        behind.append(joint)
    motors = np.zeros((len(exposed_s), 7))
    motors[:, SLOT] = np.interp(exposed_s, grid, behind)
    camera = HEAD.cameras.replaced(focal=focal * HEAD.cameras.focal)  # which nobody has calibrated
    true = replace(HEAD, cameras=camera)
    pixels = true.project(HEAD.actuation.joints_of(motors), POINT)[:, EYE]
    pixels += rng.normal(0.0, 0.1, pixels.shape)
    pixels[::17] = np.nan  # not found
    pixels[5::41] += 80.0  # another mark
    received_s = exposed_s + latency_s + jitter_s * rng.random(len(exposed_s))
    found = fit_latency_and_backlash(
        HEAD, EYE, SLOT, np.zeros(7), path, (told[2][0], told[2][-1]), received_s, pixels,
        1.15 * POINT, 1.2,
    )  # fmt: skip
    assert found.least_latency_s == pytest.approx(latency_s, abs=0.001)
    assert found.jitter_s == pytest.approx(jitter_s, abs=0.0015)
    assert found.backlash_rad == pytest.approx(backlash_rad, abs=2e-4)
    assert found.scale == pytest.approx(focal, abs=0.01)


def test_a_path_keeps_to_the_readings_where_the_motor_is_another():
    friction = {"friction_rad_s2": 5.0, "integral_rate": 12.0, "emf_rate": 12.0}
    sticking = GUESS._replace(latency_s=0.01, gain=0.95, **friction)
    told = samples(sticking)
    times = np.arange(1.0, told[2][-1] - 1.0, 0.005)
    true = simulate_motor(sticking, *told[:2], times)[0] + 0.05 * np.sin(0.2 * times)
    off = fitted_angle_path(GUESS, *told)(times) - true
    assert np.sqrt(np.mean(off**2)) < 7e-4  # of readings in steps of 1.5 mrad
    assert abs(np.mean(off * np.sign(np.gradient(true)))) < 1e-4  # which play would be


@pytest.mark.slow  # for its many simulations
def test_friction_is_found():
    rubbing = FittedMotor(
        latency_s=0.012, lag_s=0.03, gain=0.95, inverse_acceleration=1.0 / 50.0,
        friction_rad_s2=2.0, integral_rate=12.0, emf_rate=12.0,
    )  # fmt: skip
    found = fit_joint(*samples(rubbing), GUESS, STEP_RAD)
    off = np.array([*found.motor[:4], found.lag_s]) - np.array([*rubbing[:4], rubbing.lag_s])
    sigma = np.array([*found.sigma[:4], found.lag_sigma_s])
    assert (np.abs(off) < 3.0 * sigma)[[0, 2, 3, 4]].all()
    assert found.motor.latency_s == pytest.approx(0.012, abs=0.002)
    assert found.motor.friction_rad_s2 == pytest.approx(2.0, rel=0.3)
    assert found.misfit_rad < 1.5e-3


def test_an_eye_that_sees_nothing_tells_nothing():
    told = HEAD, EYE, SLOT, np.zeros(7), lambda t: 0.0 * t, (0.0, 8.0), np.linspace(0.5, 7.5, 200)
    assert fit_latency_and_backlash(*told, np.full((200, 2), np.nan), POINT, 1.2) is None


def test_the_way_stays_about_its_middle_and_within_its_reach():
    motor = FittedMotor(latency_s=0.015, lag_s=0.04, gain=0.85, inverse_acceleration=1.0 / 60.0)
    way, sent, angle = excitation_speeds(0.2, 5.0, PERIOD_S), [], [0.3]
    for requested in drift_corrected_velocities(SLOT, way, PERIOD_S, lambda: angle[-1]):
        assert np.flatnonzero(requested).tolist() in ([], [SLOT])
        sent.append(requested[SLOT])
        times = PERIOD_S * np.arange(len(sent))
        turned = simulate_motor(motor, times, np.array(sent), times[-1:] + PERIOD_S)[0][0]
        angle.append(0.3 + turned)
    assert np.abs(np.array(angle) - 0.3).max() < 0.25
