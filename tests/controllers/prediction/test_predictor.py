"""The predictor: the error that the eyes will have when the next command acts, from old images."""

import pickle

import numpy as np
import pytest

from tests.controllers.loops import begin
from tests.controllers.prediction.observed import predict, predictor_of, record, turns
from tests.controllers.reaching import run
from tests.naming import named
from vergence import load_head
from vergence.controllers.prediction.predictor import MAX_UNSEEN_S, SmithPredictor, _update
from vergence.envs.observation import ObservationLayout
from vergence.envs.task import GazeTask
from vergence.errors import ConfigurationError

QUIET = {"detection_noise_px": 0.0}


def quiet_head(name="simulated"):
    return load_head(name).replace(sensor=QUIET)


def test_the_prediction_is_the_truth_when_the_command_begins_to_act() -> None:
    head = quiet_head().replace(timing={"command_latency_s": 2 / 120})
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
    predictor = predictor_of(quiet_head())
    seen = predictor.layout.decode(np.zeros((1, predictor.layout.size), np.float32))
    compiled = []
    for one in (predictor, pickle.loads(pickle.dumps(predictor))):
        one.update(seen, np.tile(one.initial(), (1, 1)))
        compiled.append(list(_update.signatures))
    assert compiled[0] == compiled[1]


def test_what_is_left_to_turn_ends_where_both_eyes_fixate() -> None:
    for name in ["saccade", "delay-compensated"]:
        with named(name):
            task = GazeTask(20, head=quiet_head(), plant="kinematic")
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
    task = GazeTask(30, head=head, plant="kinematic")
    trial = run(task, "saccade", 60)
    tracked = np.array([p.positions for p in trial.predicted])[-6:]
    moving = trial.positions[-7:-1, :, 3:]
    # once the eyes rest, no farther than half a step
    assert np.abs(tracked - moving).max() < 0.51 * head.sensor.encoder_resolution_rad + 1e-4


def test_a_target_that_is_lost_is_held_for_a_while_then_forgotten() -> None:
    head = quiet_head()
    layout = ObservationLayout.of(head)
    predictor = SmithPredictor(head=head, layout=layout, targets_move=False)
    task = begin(GazeTask(1, head=head, plant="kinematic"))
    state = np.tile(predictor.initial(), (1, 1))
    for _ in range(12):
        seen = predictor.update(layout.decode(task.observation), state)
        task.step(np.zeros((1, 4)))
    assert seen.known.all()
    blind = layout.decode(task.observation)
    blind = blind._replace(pixel_error=np.full((1, 2, 2), np.nan))
    hold = round(MAX_UNSEEN_S * 120)
    for _ in range(hold):
        held = predictor.update(blind, state)
    np.testing.assert_allclose(held.angle_error, seen.angle_error)
    lost = predictor.update(blind, state)
    assert not lost.known.any()
    assert (lost.angle_error == 0.0).all()
    assert np.isnan(lost.pixel_error).all()


def test_a_state_may_have_rows_of_the_callers_behind_it() -> None:
    head = quiet_head()
    predictor = predictor_of(head)
    longer = np.append(predictor.initial(), [7.0, 8.0])
    own = predictor.initial()
    for seen in record(head, turns(head, 30)).observations:
        alone, behind = predictor.update(seen, own), predictor.update(seen, longer)
        assert np.array_equal(alone.angle_error, behind.angle_error)
    assert longer[-2:].tolist() == [7.0, 8.0]
    assert len(own) == predictor.size


def test_options_that_cannot_be_are_refused() -> None:
    for name in ["delay", "lag"]:
        with named(name):
            head = load_head("simulated")
            said = f"{name}: expected 'estimated' or 'nominal'"
            with pytest.raises(ConfigurationError, match=said):
                SmithPredictor(head=head, layout=ObservationLayout.of(head), **{name: "known"})
