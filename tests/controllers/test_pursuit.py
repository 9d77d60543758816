"""Smooth pursuit: the target's motion through the delay, and the eye with it."""

import numpy as np
import pytest
from scipy.linalg import expm

from tests.controllers.loops import begin, settle_time, true_errors
from vergence import load_head, make_controller
from vergence.controllers.prediction.singer import singer_transition
from vergence.controllers.prediction.target_motion import TARGET_MODEL, target_model
from vergence.envs.task import GazeTask
from vergence.errors import ConfigurationError
from vergence.eval.trials.metrics import overshoot

HEAD = load_head("simulated")
QUIET = HEAD.replace(sensor={"detection_noise_px": 0.0})


def tracking_rms(name: str, target: dict, plant: str = "kinematic", **options: object) -> float:
    """The true pixel error's rms after the first second, px."""
    task = GazeTask(1, head=HEAD, plant=plant, target=target)
    errors = true_errors(task, make_controller(name, head=HEAD, **options), 4.0)[120:]
    return float(np.sqrt((errors**2).sum(axis=-1).mean()))


# 0.25 m about a point 1 m ahead in 1.5 s: 60 degrees/s
CIRCLE = {"kind": "circle", "centre": (0.0, -0.1, 1.0), "radius": 0.25, "period": 1.5}
LINE = {"kind": "line", "origin": (-0.4, -0.1, 1.0), "end": (0.4, -0.1, 1.0), "speed": 0.19}


def test_the_model_goes_on_as_its_differential_equation_does() -> None:
    generator = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, -1.0 / 0.3]])
    assert singer_transition(0.07, 0.3) == pytest.approx(expm(0.07 * generator), abs=1e-14)


def test_the_noise_of_two_periods_is_that_of_one_twice_as_long() -> None:
    options = {
        "acceleration_sd": 2.0,
        "acceleration_time_s": 0.3,
        "start_velocity_sd": 1.0,
        "gate_rad": 0.02,
        "pixel_sd": None,
    }
    slow = HEAD.replace(timing={"control_rate_hz": 60.0, "frame_rate_hz": 60.0})
    q = []
    for head in (HEAD, slow):
        model = target_model(head, **options).view(TARGET_MODEL)[0]
        full = np.zeros((3, 3))
        full[np.triu_indices(3)] = model.noise.tolist()
        q.append(full + np.triu(full, 1).T)
    step = singer_transition(1 / 120, 0.3)
    assert step @ q[0] @ step.T + q[0] == pytest.approx(q[1], rel=1e-9)


@pytest.mark.parametrize("plant", ["kinematic", "mujoco"])
@pytest.mark.parametrize("target", [CIRCLE, LINE], ids=["circle", "line"])
def test_it_follows_with_a_quarter_of_the_best_fixed_gains_error(plant, target) -> None:
    best = min(tracking_rms("ibvs", target, gain=k) for k in (4.0, 8.0, 12.0, 14.0, 16.0, 18.0))
    assert tracking_rms("pursuit", target, plant) < 0.25 * best


def test_it_does_not_lag_behind_a_steady_target() -> None:
    task = GazeTask(1, head=QUIET, plant="kinematic", target=LINE)
    errors = true_errors(task, make_controller("pursuit", head=QUIET), 3.0)
    # 0.19 rad/s are 118 px/s: the delay alone would cost 8 px
    assert np.abs(errors[120:]).max() < 0.3


@pytest.mark.parametrize("plant", ["kinematic", "mujoco"])
def test_at_rest_it_settles_in_less_than_half_of_the_best_fixed_gains_time(plant) -> None:
    times = {}
    for name in ("ibvs-tuned", "pursuit"):
        task = GazeTask(40, head=HEAD, plant=plant)
        errors = true_errors(task, make_controller(name, head=HEAD), 2.0)
        times[name] = np.array([settle_time(errors[:, i : i + 1], 1 / 120) for i in range(40)])
        if name == "pursuit":
            assert np.median(overshoot(errors)) < 0.02
    assert (times["pursuit"] < 2.0).all()
    assert np.median(times["pursuit"]) < 0.5 * np.median(times["ibvs-tuned"])


@pytest.mark.parametrize("name", ["icub", "turrets"])
def test_its_own_defaults_settle_slow_cameras_with_coarse_encoders(name) -> None:
    head = load_head(name)
    task = GazeTask(40, head=head, plant="kinematic")
    errors = true_errors(task, make_controller("pursuit", head=head), 2.0)
    times = [settle_time(errors[:, i : i + 1], head.timing.period_s) for i in range(40)]
    # the defaults for 120 images a second leave a third of the turrets' trials outside the band
    assert (np.array(times) < 1.9).sum() >= 38


def test_on_the_articles_heads_its_defaults_are_the_numbers_that_were_published() -> None:
    for name in ("simulated", "physical"):
        head = load_head(name)
        own = make_controller("pursuit", head=head)
        given = make_controller("pursuit", head=head, gain=80.0, acceleration_sd=1.0)
        assert np.array_equal(own._law, given._law)


def test_a_target_that_vanishes_is_followed_for_a_while_and_then_given_up() -> None:
    task = GazeTask(1, head=QUIET, plant="kinematic", target=LINE)
    pursuit = make_controller("pursuit", head=QUIET)
    begin(task)
    state = None
    for step in range(180):
        observation = task.observation.copy()
        if step >= 90:
            observation[:, pursuit.layout.fields["visible"]] = 0.0
        action, state = pursuit.predict(observation, state)
        if 95 <= step < 110:
            assert np.abs(action).max() > 0.01
        task.step(action)
    assert not action.any()


def test_one_eye_that_sees_goes_on_alone() -> None:
    task = GazeTask(1, head=QUIET, plant="kinematic", target={"kind": "step"})
    pursuit = make_controller("pursuit", head=QUIET)
    begin(task)
    state = None
    for _ in range(120):
        observation = task.observation.copy()
        observation[:, pursuit.layout.fields["visible"].start] = 0.0
        action, state = pursuit.predict(observation, state)
        assert not action[:, :2].any()
        task.step(action)
    # its depth is the default then, which moves the optical centre's share of the turn alone
    assert np.linalg.norm(task.truth().pixel_error[0, 1]) < 1.0
    assert np.linalg.norm(task.truth().pixel_error[0, 0]) > 50.0


def test_an_unknown_delay_is_found_on_line() -> None:
    settled = {}
    for delay in ("nominal", "estimated"):
        options = {"latency_s": 0.1}
        task = GazeTask(20, head=HEAD, plant="kinematic", plant_options=options)
        pursuit = make_controller(
            "pursuit", head=HEAD, delay=delay, gain=40.0, acceleration_sd=0.03, pixel_sd=0.1
        )
        errors = np.linalg.norm(true_errors(task, pursuit, 2.0)[-30:], axis=-1)
        settled[delay] = (errors < 1.0).all(axis=(0, 2)).mean()
    assert settled["estimated"] == 1.0
    assert settled["nominal"] < 1.0


def test_it_comes_to_rest_inside_the_joints_limits() -> None:
    away = {"kind": "line", "origin": (0.0, -0.1, 0.5), "end": (-2.0, -0.1, 0.5), "speed": 0.8}
    task = GazeTask(1, head=QUIET, plant="kinematic", target=away)
    true_errors(task, make_controller("pursuit", head=QUIET), 2.4)
    assert QUIET.limits.contains(task.reading.positions).all()
    assert np.isfinite(task.observation).all()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"gain": 0.0}, "gain: expected a finite number above 0, got 0.0"),
        ({"braking": 1.5}, "braking: expected a share above 0 up to 1, got 1.5"),
        ({"acceleration_sd": -1.0}, "acceleration_sd: expected a finite number above 0"),
        ({"acceleration_time_s": np.inf}, "acceleration_time_s: expected a finite number"),
        ({"start_velocity_sd": np.nan}, "start_velocity_sd: expected a finite number"),
        ({"delay": "guessed"}, "delay: expected 'estimated' or 'nominal', got 'guessed'"),
        ({"gate_rad": 0.0}, "gate_rad: expected a finite number above 0"),
        ({"pixel_sd": -0.1}, "pixel_sd: expected px >= 0, got -0.1"),
    ],
)
def test_options_that_cannot_be_are_refused_by_name(options, message) -> None:
    with pytest.raises(ConfigurationError, match=message):
        make_controller("pursuit", head=HEAD, **options)
