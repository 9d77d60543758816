"""Linear laws on the prediction: where their poles lie, and that they settle."""

import numpy as np
import pytest

from tests.controllers.loops import settle_time, true_errors
from tests.joint_motion import respond
from tests.naming import named
from vergence import load_head, make_controller
from vergence.controllers.prediction.parameters import pack_predictor_parameters
from vergence.controllers.prediction.predictor import PREDICTION
from vergence.controllers.state_feedback import linear_command, pole_placement_command
from vergence.controllers.tuned import (
    find_tuned_or_fallback,
    is_tuned_for,
    tuned_or_fallback_options,
)
from vergence.envs.task import GazeTask
from vergence.eval.trials.run import run_trials
from vergence.eval.trials.scenarios import load_scenario
from vergence.kernels import make_row
from vergence.models.motion import follow_held_command, prepare_held_response

HEAD = load_head("simulated")
PERIOD_S = HEAD.timing.period_s


def asked(
    angle_error, velocity, *, build_up=0.0, known=(True, True), gain=1.0, half_swings=0.0,
    law=(20.0, 1.0),
):  # fmt: skip
    """(4,) commands to motors with a lag of 30 ms, rad/s."""
    now = make_row(
        PREDICTION,
        angle_error=angle_error,
        velocities=velocity,
        known=known,
        lag_s=0.03,
        build_up=build_up,
        speed_gain=gain,
        half_swing_count=half_swings,
    )
    rate, damping = law
    return linear_command(now, pack_predictor_parameters(HEAD), np.full(4, rate), damping)


def test_the_command_is_its_equation() -> None:
    assert asked(0.1, 0.5, law=(20.0, 0.7)) == pytest.approx(20.0 * (0.1 - 0.7 * 0.03 * 0.5))


def test_a_servo_whose_own_loop_swings_is_damped_whatever_the_option_says() -> None:
    for damping in [0.0, 0.6]:
        with named(damping):
            found = asked(0.1, 0.5, build_up=1.0, law=(20.0, damping))
            assert found == pytest.approx(asked(0.1, 0.5, build_up=1.0))
            assert found == pytest.approx(pole_placement_command(0.1, 0.5, 0.0, 20.0, 0.03, 1.0))


def test_each_swing_too_many_halves_the_rate_down_to_one_that_is_slow() -> None:
    assert asked(0.1, 0.0, half_swings=4.0) == pytest.approx(asked(0.1, 0.0) / 4.0)
    assert asked(0.1, 0.0, half_swings=6.0, law=(2.0, 1.0)) == pytest.approx(1.0 * 0.1)


def test_the_command_is_for_what_the_motors_make_of_it_and_can_follow() -> None:
    assert asked(0.1, 0.5, gain=1.25) == pytest.approx(asked(0.1, 0.5) / 1.25)
    assert asked(1.0, 0.0, gain=1.0) == pytest.approx(HEAD.actuation.velocity[3:])


def test_an_eye_without_a_target_is_held() -> None:
    assert (asked(0.1, 0.5, known=(False, True)) != 0.0).tolist() == [False, False, True, True]


def test_with_full_damping_what_is_left_decays_at_the_rate_of_the_gain() -> None:
    for gain in [5.0, 20.0]:
        with named(gain):
            q, v, angle_error = 0.0, 0.0, 0.02
            for _ in range(60):
                u = asked(angle_error - q, v, law=(gain, 1.0))[1]
                before = angle_error - q - 0.03 * v
                q, v = respond(q, v, u, 0.03, 1e6, PERIOD_S)
                # one pole cancels the lag
                after = before * (1.0 - gain * PERIOD_S)
                assert angle_error - q - 0.03 * v == pytest.approx(after, abs=1e-12)


@pytest.mark.slow
def test_tuned_it_settles_sooner_than_any_gain_on_the_predicted_error() -> None:
    times = {}
    for name in ("delay-compensated", "state-feedback"):
        options = tuned_or_fallback_options(name, "workspace", HEAD)
        task = GazeTask(40, head=HEAD, plant="kinematic")
        errors = true_errors(task, make_controller(name, HEAD, **options), 1.0)
        times[name] = settle_time(errors, PERIOD_S)
    assert (times["state-feedback"] < 0.4).all()
    assert np.median(times["state-feedback"]) < 0.75 * np.median(times["delay-compensated"])


LAG_S = 0.03
SERVO_PERIOD_S = 1.0 / 240.0


def angles(build_up, known, rate=30.0):
    """Angles on the way to 1 rad, under the law that knows of so much build-up."""
    q = v = w = 0.0
    way = []
    for _ in range(240):
        u = pole_placement_command(1.0 - q, v, w, rate, LAG_S, known)
        q, v, w = follow_held_command(
            q, v, w, u, prepare_held_response(LAG_S, build_up, np.inf, SERVO_PERIOD_S)
        )
        way.append(q)
    return np.array(way)


def test_a_servo_that_overshoots_hardly_passes_its_goal() -> None:
    for build_up in [1.0, 2.0]:
        with named(build_up):
            way = angles(build_up, build_up)
            assert way.max() < 1.01
            assert angles(build_up, 0.0).max() > 1.05
            assert abs(way[-1] - 1.0) < 1e-3


@pytest.mark.parametrize("scenario", ["hardware", "webcam"])
def test_it_settles_on_heads_whose_speeds_come_in_ticks(scenario: str) -> None:
    loaded = load_scenario(scenario)
    head = loaded.model()
    assert head.sensor.command_resolution_rad_s > 0.0
    assert is_tuned_for(find_tuned_or_fallback("delay-compensated", scenario, head), head)
    options = tuned_or_fallback_options("delay-compensated", scenario, head)
    trials = run_trials(make_controller("delay-compensated", head, **options), loaded, episodes=20)
    # without what steps leave being carried on, half of them stop short of the band
    assert np.isfinite(trials.settle_s(2.0)).mean() >= 0.95
