"""PID in the image: its three actions one by one, its memory, its limits."""

import numpy as np
import pytest

from tests.controllers.loops import true_errors
from vergence import load_head, make_controller
from vergence.envs.observation import Observation
from vergence.envs.task import GazeTask

HEAD = load_head("simulated")
QUIET = HEAD.replace(sensor={"detection_noise_px": 0.0})
AT = HEAD.fixate(np.array([0.0, -0.1, 1.0]))
PERIOD_S, LATENCY_S = HEAD.timing.period_s, HEAD.timing.latency_s


def feed(controller, errors, ages=None, speed_rad_s=0.0):
    """(steps, 4) commands for a series of (2, 2) errors, at unmoved joints of a measured speed."""
    state = controller._initial()
    ages = np.full(len(errors), LATENCY_S) if ages is None else ages
    commands = []
    for error, age in zip(errors, ages, strict=True):
        seen = Observation(
            pixel_error=np.asarray(error), visible=np.isfinite(error).all(axis=-1),
            image_age_s=np.asarray(age), positions=AT, positions_at_exposure=AT,
            velocities=np.full(7, speed_rad_s), last_command=np.zeros(4),
        )  # fmt: skip
        commands.append(controller._command(seen, state))
    return np.array(commands)


def law(errors, gain):
    """The article's law on the same images."""
    return make_controller("ibvs", head=HEAD, gain=gain).command(AT, errors)


RAMP = np.array([[10.0, -4.0], [6.0, 8.0]]) + 2.0 * np.arange(30)[:, None, None]


def test_the_integral_adds_up_the_error_over_time() -> None:
    error = np.broadcast_to([[10.0, -4.0], [6.0, 8.0]], (121, 2, 2))
    command = feed(make_controller("pid", head=HEAD, kp=0.0, ki=2.0, kd=0.0), error)
    # 120 periods have passed before the last command: one second
    assert command[-1] == pytest.approx(law(error[0], gain=2.0), rel=1e-9)
    assert not command[0].any()


def derivative(filter_s: float, every: int) -> tuple[np.ndarray, np.ndarray]:
    """The ramp in images some periods apart, and the commands of the derivative alone."""
    seen = RAMP[np.arange(30) // every * every]
    ages = LATENCY_S + PERIOD_S * (np.arange(30) % every)
    pid = make_controller("pid", head=HEAD, kp=0.0, ki=0.0, kd=0.5, filter_s=filter_s)
    return seen, feed(pid, seen, ages)


@pytest.mark.parametrize("every", [1, 2])
def test_the_derivative_is_the_errors_rate_over_the_time_of_images(every) -> None:
    seen, command = derivative(0.0, every)
    rate = np.full((2, 2), 2.0 / PERIOD_S)
    assert not command[0].any()
    assert np.array_equal(command[every::every], command[2 * every - 1 :: every])
    assert command[-1] == pytest.approx(law(seen[-1], gain=0.5 * rate / seen[-1]), rel=1e-9)


@pytest.mark.parametrize(("every", "left"), [(1, 0.75), (2, 0.6)])
def test_the_derivatives_filter_is_of_first_order_in_the_time_of_images(every, left) -> None:
    # implicit steps: each image leaves filter / (filter + time since the last one) of what is
    # missing; J changes by 1 % as the image moves
    filtered, plain = (
        derivative(filter_s, every)[1][every::every, 1] for filter_s in (3.0 * PERIOD_S, 0.0)
    )
    remaining = 1.0 - filtered[:9] / plain[:9]
    assert remaining == pytest.approx(left ** np.arange(1, 10), rel=1e-6)


def test_a_jump_of_the_target_is_no_rate() -> None:
    error = np.zeros((10, 2, 2))
    error[5:] = 200.0
    command = feed(make_controller("pid", head=HEAD, kp=1.0, ki=0.0, kd=0.5), error)
    # the second detection of it tells it from an outlier
    assert not command[5].any()
    assert command[6] == pytest.approx(law(error[6], gain=1.0))


def test_the_integral_does_not_wind_up_at_the_limits() -> None:
    # kp alone already asks for more than the joints can: the integral waits, and goes on after
    pid = make_controller("pid", head=HEAD, kp=40.0, ki=40.0, kd=0.0)
    far = np.full((120, 2, 2), 300.0)
    near = np.full((2, 2, 2), 1.0)
    # so fast that the gate takes the way from far to near for the eyes' own
    command = feed(pid, np.concatenate([far, near]), speed_rad_s=40.0)
    assert np.abs(command[:120].reshape(-1, 2, 2)).max(axis=2) == pytest.approx(6.0)
    assert command[120] == pytest.approx(law(near[0], gain=40.0), rel=1e-9)
    assert command[121] == pytest.approx(law(near[0], gain=40.0 + 40.0 * PERIOD_S), rel=1e-9)


def test_an_eye_that_loses_its_target_is_held_and_forgets() -> None:
    error = np.repeat(RAMP[:1], 40, axis=0).copy()
    error[10:30, 0] = np.nan
    pid = make_controller("pid", head=HEAD, kp=3.0, ki=5.0, kd=0.1)
    command = feed(pid, error)
    # missed detections are bridged for a twentieth of a second
    assert not command[22:30, :2].any()
    assert command[30, :2] == pytest.approx(command[0, :2])
    assert np.abs(command[30, 2:] - command[0, 2:]).max() > 1e-3


def test_an_outlier_is_neither_a_rate_nor_integrated() -> None:
    error = np.repeat(RAMP[:1], 20, axis=0).copy()
    quiet = make_controller("pid", head=HEAD, kp=3.0, ki=5.0, kd=0.5)
    undisturbed = feed(quiet, error)
    error[10, 0] += [70.0, -60.0]
    command = feed(quiet, error)
    assert np.array_equal(command[:10], undisturbed[:10])
    # the integral takes in the period of the outlier with the next image
    assert command[12:] == pytest.approx(undisturbed[12:], rel=1e-9)
    assert command[11, :2] == pytest.approx(undisturbed[11, :2], rel=0.02)
    assert command[10, :2] == pytest.approx(undisturbed[10, :2], rel=0.02)


def test_with_kp_alone_it_is_the_fixed_gain_law_of_each_eye_and_axis() -> None:
    gains = [[1.0, 2.0], [3.0, 4.0]]
    pid = make_controller("pid", head=HEAD, kp=gains, ki=0.0, kd=0.0)
    assert feed(pid, RAMP) == pytest.approx(law(RAMP, gain=gains), abs=1e-12)


def test_an_integral_takes_away_the_lag_behind_a_steady_target() -> None:
    target = {"kind": "line", "origin": (-0.2, -0.1, 1.0), "end": (0.2, -0.1, 1.0), "speed": 0.1}
    lag = []
    for ki in (0.0, 4.0):
        task = GazeTask(1, head=QUIET, plant="kinematic", target=target)
        pid = make_controller("pid", head=QUIET, layout=task.layout, kp=3.0, ki=ki, kd=0.0)
        lag.append(np.abs(true_errors(task, pid, 3.5)[-60:, 0, :, 0]).mean())
    # 0.1 rad/s less what the depth changes, by kp, at 620 px/rad
    assert lag[0] == pytest.approx(0.1 / 3.0 * 620.0, rel=0.1)
    assert lag[1] < 0.1 * lag[0]
