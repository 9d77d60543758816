"""The predictor: the error when the next command acts, on any head and at any rate."""

import pickle

import numpy as np
import pytest

from tests.controllers.loops import settle_time
from tests.controllers.prediction.observed import (
    predict,
    predicted,
    predictor_of,
    record,
    saccades,
    turns,
)
from tests.controllers.reaching import run
from tests.heads import CENTRE, IMAGE, LOOP, eyes, head_of, joint
from tests.naming import named
from vergence import load_head
from vergence.controllers.prediction.parameters import (
    PREDICTOR_PARAMETERS,
    pack_predictor_parameters,
    with_virtual_joints,
)
from vergence.controllers.prediction.predictor import MAX_UNSEEN_S, SmithPredictor, _update
from vergence.envs.observation import ObservationLayout
from vergence.envs.task import GazeTask
from vergence.errors import ConfigurationError
from vergence.models import parse_head
from vergence.models.fixation import fixate_eye
from vergence.models.kinematics import eye_frames

HEAD = load_head("simulated")
QUIET = HEAD.replace(sensor={"detection_noise_px": 0.0})


def test_the_prediction_is_the_truth_when_the_command_begins_to_act() -> None:
    head = QUIET.replace(timing={"command_latency_s": 2 / 120})
    commands = np.concatenate([turns(head, 60), turns(head, 60)])
    way = record(head, commands, latency_s=2 / 120)
    every = predict(predictor_of(head), way)
    # by the second turn the response is known, to a fraction of a millisecond
    joints = np.array([one.positions for one in every])
    ahead_s = [one.response_latency_s + 0.5 * one.response_latency_sd_s for one in every]
    at = np.arange(len(joints)) + 120.0 * np.array(ahead_s)
    true = np.array([np.interp(at, np.arange(len(joints)), column) for column in way.positions.T]).T
    # between two periods the truth is not straight, which 0.2 mrad or 0.1 px allow for
    assert np.abs(true - joints)[60:110].max() < 0.002
    assert np.abs(np.diff(way.positions, axis=0)).max() > 0.02


def test_a_copy_for_another_process_compiles_nothing_anew() -> None:
    predictor = predictor_of(QUIET)
    seen = predictor.layout.decode(np.zeros((1, predictor.layout.size), np.float32))
    compiled = []
    for one in (predictor, pickle.loads(pickle.dumps(predictor))):
        one.update(seen, np.tile(one.initial(), (1, 1)))
        compiled.append(list(_update.signatures))
    assert compiled[0] == compiled[1]


def test_what_is_left_to_turn_ends_where_both_eyes_fixate() -> None:
    for name in ["saccade", "delay-compensated"]:
        with named(name):
            task = GazeTask(20, head=QUIET, plant="kinematic")
            trial = run(task, name, 40)
            truth = task.truth()
            goal = task.head.fixate(truth.target, task.head.rest()[:3])[:, 3:]
            known = np.array([p.known for p in trial.predicted])
            assert known[8:].all()
            assert not known[:8].any()
            for now in trial.predicted[8:]:
                # 0.6 px, in full motion
                assert np.abs(now.positions + now.angle_error - goal).max() < 1e-3
            assert np.abs(now.positions + now.angle_error - goal).max() < 2e-4


def test_angles_between_the_steps_of_the_encoders_are_followed() -> None:
    head = load_head("physical")
    trial = saccades(head, 60, num=30)
    tracked = np.array([p.positions for p in trial.predicted])[-6:]
    moving = trial.positions[-7:-1, :, 3:]
    # once the eyes rest, no farther than half a step
    assert np.abs(tracked - moving).max() < 0.51 * head.sensor.encoder_resolution_rad + 1e-4


def test_a_target_that_is_lost_is_held_for_a_while_then_forgotten() -> None:
    predictor = predictor_of(QUIET)
    state, still = predictor.initial(), record(QUIET, np.zeros((12, 4))).observations
    for observation in still:
        seen = predicted(predictor, observation, state)
    assert seen.known.all()
    blind = observation._replace(pixel_error=np.full((2, 2), np.nan))
    for _ in range(round(MAX_UNSEEN_S * 120)):
        held = predicted(predictor, blind, state)
    np.testing.assert_allclose(held.angle_error, seen.angle_error)
    lost = predicted(predictor, blind, state)
    assert not lost.known.any()
    assert (lost.angle_error == 0.0).all()
    assert np.isnan(lost.pixel_error).all()


def test_a_state_may_have_rows_of_the_callers_behind_it() -> None:
    predictor = predictor_of(QUIET)
    longer = np.append(predictor.initial(), [7.0, 8.0])
    own = predictor.initial()
    for seen in record(QUIET, turns(QUIET, 30)).observations:
        alone, behind = predictor.update(seen, own), predictor.update(seen, longer)
        assert np.array_equal(alone, behind, equal_nan=True)
    assert longer[-2:].tolist() == [7.0, 8.0]
    assert len(own) == predictor.size


def test_options_and_latencies_that_cannot_be_are_refused() -> None:
    late = HEAD.replace(timing={"latency_s": 0.26})
    for head, options, said in (
        (HEAD, {"delay": "known"}, "delay: expected 'estimated' or 'nominal', got 'known'"),
        (HEAD, {"lag": "known"}, "lag: expected 'estimated' or 'nominal', got 'known'"),
        (late, {}, r"head: expected a latency of at most 0\.25 s, got 0\.26 s"),
    ):
        with pytest.raises(ConfigurationError, match=f"^{said}$"):
            SmithPredictor(head=head, layout=ObservationLayout.of(head), **options)


EXACT = {"detection_noise_px": 0.0, "encoder_resolution_rad": 0.0, "velocity_resolution_rad_s": 0.0}


def skewed():
    """A head whose axes are in no way at right angles; its eyes turn about their centres."""
    text = 'name = "skewed"\n'
    for eye, side in (("left", -1), ("right", 1)):
        text += joint(f"{eye}_one", eye, (side * 0.05, 0, 0), (0.9, 0.3 * side, 0.1))
        text += joint(f"{eye}_two", eye, CENTRE, (0.35, 0.9, -0.2 * side))
    return parse_head(text + IMAGE + eyes() + LOOP)


def test_axes_at_right_angles_are_told_from_others() -> None:
    for head, told in ((head_of("panfirst"), 1.0), (load_head("simulated"), 1.0), (skewed(), 0.0)):
        params = pack_predictor_parameters(head).view(PREDICTOR_PARAMETERS)
        assert (params["orthogonal_axes"] == told).all()


@pytest.mark.parametrize(
    ("head", "delay"),
    [(skewed(), 4), (head_of("panfirst"), 13), (head_of("tied"), 13), (head_of("mis"), 4)],
)
def test_one_saccade_tells_the_delay_on_any_head(head, delay) -> None:
    found = saccades(head, 60, num=8, latency_s=delay / 120.0).predicted[-1].image_delay_s
    assert np.abs(np.median(found) - delay / 120.0) < 0.005


@pytest.mark.parametrize("name", ["mis", "panfirst", "vergeonly"])
def test_without_noise_the_prediction_is_the_error_at_its_angles_on_any_head(name) -> None:
    head = head_of(name).replace(sensor=EXACT)
    task = GazeTask(8, head=head, plant="kinematic")
    trial = run(task, "saccade", 60)
    target = task.truth().target
    for now in trial.predicted[12::4]:
        q = np.concatenate([np.tile(head.rest()[:3], (8, 1)), now.positions], axis=-1)
        error = head.project(q, target, distorted=False) - head.cameras.principal
        assert np.linalg.norm(now.pixel_error - error, axis=-1).max() < 0.7


def test_joints_made_up_for_an_eye_leave_the_cameras_where_they_are() -> None:
    for name in ["common", "vergeonly", "pair"]:
        with named(name):
            head = head_of(name)
            q = np.zeros(7)
            q[3:] = np.where([bool(one) for one in head.joints[3:]], [0.2, -0.1, 0.2, -0.1], 0.0)
            packed = with_virtual_joints(head)
            for eye in range(2):
                angles = q[3 + 2 * eye : 5 + 2 * eye]
                own = eye_frames(head.packed, eye, *angles).camera
                assert eye_frames(packed, eye, *angles).camera == pytest.approx(own)
                assert np.isfinite(fixate_eye(packed, eye, 0.1, 0.15, 0.9)).all()


def test_each_actuator_is_followed_by_its_own_lag_and_encoder() -> None:
    lags = {"lag_s": [0.015, 0.03, 0.06], "encoder_resolution_rad": [0.002, 0.0005, 0.001]}
    head = head_of("tied").replace(actuators=lags)
    trial = saccades(head, 120, num=8)
    lag_s = np.array([p.lag_s for p in trial.predicted])
    assert np.abs(np.median(lag_s[-1]) - 0.03) < 0.003
    for place in range(8):
        assert settle_time(trial.errors[:, place : place + 1], 1 / 120) < 0.4


@pytest.mark.parametrize(
    ("name", "control_hz", "frame_hz", "known_s", "true_s"),
    [
        ("saccade", 50, 15, 1 / 15, 0.1), ("pursuit", 60, 30, 1 / 15, 0.1),
        ("pursuit", 250, 15, 1 / 15, 0.1), ("saccade", 250, 250, 1 / 15, 0.1),
        ("saccade", 50, 50, 0.0, 0.01), ("saccade", 120, 50, 0.25, 0.26),
        ("saccade", 250, 50, 0.12, 0.13),
    ],
)  # fmt: skip
def test_a_saccade_settles_whatever_the_rates_and_the_delay(
    name, control_hz, frame_hz, known_s, true_s
) -> None:
    timing = {"control_rate_hz": control_hz, "frame_rate_hz": frame_hz, "latency_s": known_s}
    options = {"latency_s": true_s, "command_latency_s": 0.008, "frame_phase": 0.4}
    steps = round((0.6 + known_s + 4.0 / frame_hz) * control_hz)
    errors = saccades(HEAD.replace(timing=timing), steps, name, **options).errors
    assert np.linalg.norm(errors, axis=-1)[-round(0.1 * control_hz) :].max() < 1.0
