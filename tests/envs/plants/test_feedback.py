"""Joint readings: latency, noise, quantisation, backlash (play)."""

import numpy as np
import pytest

from tests.envs.plants.trajectory import motion_of, swing
from tests.envs.trials import assert_white_normal, pixels_of, start_of, steps
from tests.naming import named
from vergence import HeadModel, load_head
from vergence.envs.plant import make_plant

T = 1 / 120


@pytest.mark.parametrize(
    ("periods", "plant_name"), [(0.0, "mujoco"), (3.0, "kinematic"), (1.6, "kinematic")]
)
def test_joints_are_read_as_they_were_one_latency_ago(exact, plant_name, periods) -> None:
    commands = swing(55, T)
    own = {"neck": "welded"} if plant_name == "mujoco" else {}
    plant = make_plant(plant_name, exact, 1, feedback_latency_s=periods * T, **own)
    readings, true, rates = steps(plant, start_of(), 55, lambda k: commands[k])
    motion = motion_of(exact, commands)
    for step, reading in enumerate(readings):
        q, v = motion((step - periods) * T)
        # MuJoCo's joints are these within 50 urad; between two periods a cubic, and for the
        # velocity, whose lag is some four periods, a chord
        assert reading.positions[0] == pytest.approx(q, abs=5e-5)
        assert reading.velocities[0] == pytest.approx(v, abs=0.02)
        if periods == int(periods):
            then = max(step - int(periods), 0)
            assert np.array_equal(reading.positions, true[then])
            assert np.array_equal(reading.velocities, rates[then])
    assert np.abs(motion(0.4)[0] - motion(0.4 - T)[0]).max() > 2e-3


def test_a_reading_dates_the_joints_by_the_nominal_latency(exact: HeadModel) -> None:
    head = exact.replace(timing={"feedback_latency_s": 0.006})
    plant = make_plant("kinematic", head, 2, feedback_latency_s=[0.0, 0.02])
    readings, _q, _v = steps(plant, start_of(2), 20)
    for reading in readings:
        assert reading.joints_s == pytest.approx(reading.time_s - 0.006, abs=1e-12)


def test_encoders_noise_is_white_normal_and_as_large_as_said(exact) -> None:
    angle, speed, num, count = 2e-3, 0.05, 64, 250
    plant = make_plant("kinematic", exact, num, angle_noise_rad=angle, speed_noise_rad_s=speed)
    readings, q, v = steps(plant, start_of(num), count)
    for name, true, sigma in (("positions", q, angle), ("velocities", v, speed)):
        off = np.array([getattr(reading, name) for reading in readings])[1:] - true[1:]
        assert not off[..., :3].any()  # the neck's are exact
        assert_white_normal(off[..., 3:], sigma)


def test_noise_comes_before_the_encoders_steps(physical: HeadModel) -> None:
    step = physical.sensor.encoder_resolution_rad
    plant = make_plant("kinematic", physical, 32, angle_noise_rad=step)
    readings, _q, _v = steps(plant, start_of(32), 60)
    counts = np.array([reading.positions for reading in readings[1:]])[..., 3:] / step
    assert counts == pytest.approx(np.round(counts), abs=1e-9)
    # a rounded normal has a twelfth of a step's square on top
    assert counts.std() == pytest.approx(np.sqrt(1.0 + 1.0 / 12.0), rel=0.03)


@pytest.mark.parametrize(("side", "plant_name"), [("motor", "mujoco"), ("output", "kinematic")])
def test_play_shows_in_the_images_and_where_encoders_sit_beyond_it(exact, plant_name, side) -> None:
    play = 0.02
    head = exact.replace(sensor={"encoder_side": side})
    plant = make_plant(plant_name, head, 1, backlash_rad=play)
    command = np.zeros(7)
    command[3:] = [0.4, 0.5, -0.4, 0.3]
    readings, q, _v = steps(plant, start_of(), 140, lambda k: command * (1.0 if k < 60 else -1.0))
    motors = plant.truth().motors
    assert np.abs(motors - q[-1])[0, 3:] == pytest.approx(np.full(4, 0.5 * play), abs=1e-6)
    for step in range(10, 141):
        # the image is that of the joints, whatever the encoders say
        then = q[step - 8]
        assert readings[step].pixels == pytest.approx(pixels_of(head, then, q[0]), abs=1e-6)
    off = np.array([reading.positions[0] for reading in readings])[:, 3:] - q[:, 0, 3:]
    if side == "output":
        assert np.abs(off).max() < 1e-9
        return
    turn = np.sign(command[3:])
    assert off[55] == pytest.approx(0.5 * play * turn, abs=1e-6)
    assert off[-1] == pytest.approx(-0.5 * play * turn, abs=1e-6)


def test_an_encoder_beyond_the_play_says_that_the_joint_stands_still(exact) -> None:
    head = exact.replace(sensor={"encoder_side": "output"})
    plant = make_plant("mujoco", head, 1, backlash_rad=0.03)
    command = np.array([0, 0, 0, 0.5, 0, 0, 0])
    readings, _q, _v = steps(plant, start_of(), 90, lambda k: command * (1.0 if k < 50 else -1.0))
    speeds = np.array([reading.velocities[0, 3] for reading in readings])
    angles = np.array([reading.positions[0, 3] for reading in readings])
    # 0.03 rad at 0.5 rad/s take seven periods, in which the motor turns and the joint does not
    crossing = slice(54, 58)
    assert not speeds[crossing].any()
    assert np.ptp(angles[crossing]) < 1e-9
    assert speeds[45] == pytest.approx(0.5, abs=5e-3)
    assert speeds[-1] == pytest.approx(-0.5, abs=5e-3)


def test_a_filtered_speed_is_a_low_pass_of_first_order(exact: HeadModel) -> None:
    lag_s, filter_s, u = exact.timing.lag_s, 0.05, 0.5
    plant = make_plant("kinematic", exact, 2, speed_filter_s=[0.0, filter_s])
    readings, _q, v = steps(plant, start_of(2), 40, [0, 0, 0, u, 0, 0, 0])
    t = np.arange(41) * T
    # two lags in a row, by their partial fractions
    fast, slow = lag_s * np.exp(-t / lag_s), filter_s * np.exp(-t / filter_s)
    speeds = np.array([reading.velocities[:, 3] for reading in readings])
    # a chord through each period instead of the lag's curve
    assert speeds[:, 1] == pytest.approx(u * (1.0 - (fast - slow) / (lag_s - filter_s)), abs=1e-3)
    assert np.array_equal(speeds[:, 0], v[:, 0, 3])


@pytest.mark.parametrize(("periods", "plant_name"), [(3.0, "mujoco"), (1.6, "kinematic")])
def test_a_late_speed_is_older_than_the_angle_beside_it(exact, plant_name, periods) -> None:
    commands = swing(60, T)
    own = {"neck": "welded"} if plant_name == "mujoco" else {}
    late = {"speed_latency_s": periods * T, "feedback_latency_s": T}
    plant = make_plant(plant_name, exact, 1, **late, **own)
    readings, true, rates = steps(plant, start_of(), 60, lambda k: commands[k])
    whole, share = int(periods), periods % 1.0
    for step, reading in enumerate(readings):
        new, old = (rates[max(step - 1 - whole - more, 0)] for more in (0, 1))
        assert np.array_equal(reading.positions, true[max(step - 1, 0)])
        assert reading.velocities == pytest.approx((1.0 - share) * new + share * old, abs=1e-12)


def test_a_speed_by_difference_is_that_of_the_angles_as_read() -> None:
    for span, head_name in [(0.6, "icub"), (1.0, "turrets"), (2.4, "physical"), (7.0, "turrets")]:
        with named(span, head_name):
            head = load_head(head_name)
            period_s, periods = head.timing.period_s, round(span)
            # what servos make of their own speeds has no part in it
            others = {"speed_noise_rad_s": 1.0, "speed_filter_s": 0.1, "speed_latency_s": 0.02}
            options = {"speed_span_s": span * period_s, "angle_noise_rad": 0.001, **others}
            plant = make_plant("kinematic", head, 2, **options)
            readings, _q, _v = steps(plant, start_of(2), 30, [0.0, 0, 0, 0.1, 0.2, -0.1, 0.1])
            angles = np.array([reading.positions for reading in readings])
            for step in range(periods + 1, 31):
                speed = (angles[step] - angles[step - periods]) / (periods * period_s)
                assert readings[step].velocities == pytest.approx(speed, abs=1e-10)
            assert np.ptp(angles, axis=0).max() > 0.01


def test_a_difference_over_less_than_half_a_period_is_the_servos_own_speed(exact) -> None:
    plant = make_plant("kinematic", exact, 2, speed_span_s=[0.0, 0.49 * T])
    readings, _q, v = steps(plant, start_of(2), 20, [0, 0, 0, 0.5, 0, 0, 0])
    for reading, rates in zip(readings, v, strict=True):
        assert np.array_equal(reading.velocities, rates)


def test_a_filtered_speed_has_the_encoders_noise_and_steps_behind_the_filter(physical) -> None:
    step = physical.sensor.velocity_resolution_rad_s
    options = {"speed_filter_s": 0.5, "speed_noise_rad_s": 4.0 * step}
    plant = make_plant("kinematic", physical, 64, **options)
    readings, _q, _v = steps(plant, start_of(64), 60)
    counts = np.array([reading.velocities for reading in readings[1:]])[..., 3:] / step
    assert counts == pytest.approx(np.round(counts), abs=1e-9)
    assert counts.std() == pytest.approx(4.0, rel=0.02)
