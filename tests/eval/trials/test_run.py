"""Trials: what is known beforehand comes out, and nothing depends on how they were run."""

import dataclasses

import numpy as np
import pytest

from tests.eval.trials.toys import NOISELESS, PERIOD_S, STEP, KnowsTheWay, ToyScenario, ideal_head
from tests.heads import head_of
from vergence.controllers import make_controller
from vergence.envs.plant import PLANTS
from vergence.errors import ConfigurationError
from vergence.eval.trials.run import headline_metric, run_trials
from vergence.eval.trials.scenarios import load_scenario
from vergence.models.head_file import load_head

RANDOM = ToyScenario("random", duration_s=0.8)


def ibvs(head="simulated", **options):
    scenario = ToyScenario("random", head=head)
    task = scenario.task(1)
    return make_controller("ibvs", task.head, task.layout, **options)


def test_the_settle_time_of_a_controller_that_knows_the_way_is_exact():
    for wait in (0, 7, 30):
        trials = run_trials(KnowsTheWay(wait), STEP, episodes=3)
        # the command given after `wait` periods has done its work one period later
        assert trials.settle_s() == pytest.approx([(wait + 1) * PERIOD_S] * 3, abs=1e-12)
        assert headline_metric(trials) == pytest.approx((wait + 1) * PERIOD_S)
    batches = run_trials(KnowsTheWay(4), STEP, episodes=4, batch_size=2)
    # a state starts anew with every batch
    assert batches.settle_s() == pytest.approx([5 * PERIOD_S] * 4, abs=1e-12)


def test_a_trial_that_never_settles_counts_as_the_whole_trial():
    trials = run_trials(KnowsTheWay(5, never=(0, 2, 3)), STEP, episodes=5)
    assert np.isnan(trials.settle_s()).tolist() == [True, False, True, True, False]
    assert headline_metric(trials) == STEP.duration_s
    # of a trial that never settled there is no ratio
    ratio = np.where(np.isnan(trials.settle_s()), np.inf, 6 * PERIOD_S / trials.bound_s)
    assert trials.ratio_to_bound() == pytest.approx(ratio)


def test_a_missing_error_counts_as_the_larger_images_diagonal():
    cameras = {"size": [[640, 480], [640, 360]], "principal": [[320.0, 240.0], [320.0, 180.0]]}
    trials = run_trials(KnowsTheWay(5), STEP, episodes=1)
    trials = dataclasses.replace(trials, head=load_head("physical").replace(cameras=cameras))
    assert trials.missing_px == 800.0


def test_a_trial_is_the_same_alone_and_in_any_batch():
    whole = run_trials(ibvs(), RANDOM, episodes=7)
    split = run_trials(ibvs(), RANDOM, episodes=7, batch_size=3)
    alone = run_trials(ibvs(), RANDOM, episodes=1, first_trial=5)
    assert np.array_equal(whole.error, split.error)
    assert np.array_equal(whole.command, split.command)
    assert np.array_equal(whole.error[:, 5], alone.error[:, 0])


def test_every_controller_gets_the_same_targets_and_the_same_start():
    one = run_trials(ibvs(gain=2.0), RANDOM, episodes=4)
    other = run_trials(ibvs(gain=5.0), RANDOM, episodes=4)
    assert np.array_equal(one.target, other.target)
    assert np.array_equal(one.error[0], other.error[0])
    assert not np.array_equal(one.error[-1], other.error[-1])


def test_what_each_actuator_drew_is_told_by_its_name():
    scenario = load_scenario("webcam")
    head = scenario.model()
    trials = run_trials(make_controller("ibvs", head), scenario, episodes=12)
    task = scenario.task(12)
    ids, seed = np.arange(12), scenario.seed("test", 0)
    task.begin(ids, np.full(12, seed, np.uint64), ids.astype(np.uint64))
    drawn = task.plant.conditions
    for name in ("speed_gain", "backlash_rad"):
        told = [trials.conditions[f"{name}_{one}"] for one in head.actuation.names]
        assert np.array_equal(np.transpose(told), getattr(drawn, name)[:, 3:])
        assert len(np.unique(told)) == 48
    icub = run_trials(ibvs("icub"), ToyScenario("random", head="icub"), episodes=2).conditions
    assert [name for name in icub if name.startswith("speed_gain")] == [
        "speed_gain_eyes_tilt", "speed_gain_eyes_version", "speed_gain_eyes_vergence",
    ]  # fmt: skip


def test_splits_and_seeds_are_other_trials():
    runs = [
        run_trials(ibvs(), RANDOM, episodes=2, split=split, seed=seed).target[0]
        for split, seed in (("test", 0), ("test", 1), ("train", 0), ("validation", 0))
    ]
    for i, one in enumerate(runs):
        assert not any(np.allclose(one, other) for other in runs[i + 1 :])


def test_settling_is_within_the_band_around_the_least_error_that_a_head_can_reach():
    head = head_of("common")  # both eyes on one pan and tilt: each stays off by half the baseline
    controller = make_controller("saccade", head)
    trials = run_trials(controller, ToyScenario("random", duration_s=1.0, head=head), episodes=5)
    settled = trials.settle_s()
    assert np.isfinite(settled).all()
    assert (trials.residual_px > 5.0).all()
    # the errors themselves never come near zero, and end where the residual is
    assert (np.linalg.norm(trials.error, axis=-1).max(axis=-1) > 5.0).all()
    assert trials.error[-1] == pytest.approx(trials.residual, abs=1.0)
    assert (trials.steady_px < 1.0).all()
    assert (trials.overshoot < 0.1).all()
    assert (settled >= trials.bound_s).all()


def test_a_head_whose_eyes_have_two_motors_each_has_no_residual():
    trials = run_trials(ibvs(), RANDOM, episodes=2)
    assert not trials.residual.any()
    assert np.isnan(trials.residual_px).all()
    assert np.array_equal(trials.reducible_error, trials.error)


def test_of_a_moving_target_the_error_counts_as_it_is():
    head = head_of("common")
    circle = ToyScenario("circle", duration_s=2.0, target_moves=True, head=head)
    trials = run_trials(make_controller("ibvs", head), circle, episodes=2)
    assert not trials.residual.any()
    assert (trials.tracking_px > 5.0).all()


def test_without_truth_the_residual_is_the_model_s_where_it_sees_the_target(monkeypatch):
    monkeypatch.setitem(PLANTS, "blind", "tests.eval.trials.toys:BlindPlant")
    head = head_of("mis").replace(sensor={"detection_noise_px": 0.0})
    scenario = ToyScenario(STEP.target, duration_s=1.2, head=head)
    controller = make_controller("ibvs", head)
    true = run_trials(controller, scenario, episodes=1)
    measured = run_trials(controller, scenario, episodes=1, plant="blind")
    assert measured.residual == pytest.approx(true.residual, abs=0.02)
    assert measured.settle_s() == pytest.approx(true.settle_s(), abs=2 * PERIOD_S)


def test_without_truth_the_measured_errors_stand_at_their_exposure(monkeypatch):
    monkeypatch.setitem(PLANTS, "blind", "tests.eval.trials.toys:BlindPlant")
    head = ideal_head()
    controller = ibvs(head)
    scenario = ToyScenario(STEP.target, duration_s=1.2, head=head)
    true = run_trials(controller, scenario, episodes=2)
    measured = run_trials(controller, scenario, episodes=2, plant="blind")
    assert NOISELESS["detection_noise_px"] == head.sensor.detection_noise_px
    assert measured.error == pytest.approx(true.error, abs=1e-6)
    assert measured.settle_s() == pytest.approx(true.settle_s())
    assert np.isnan(measured.fix_error_m).all()


def test_steady_eyes_trail_a_moving_target_by_the_inverse_of_the_gain():
    circle = ToyScenario(
        {"kind": "circle", "period": 30.0}, duration_s=3.0, target_moves=True, head=ideal_head()
    )
    trials = run_trials(ibvs(ideal_head(), gain=4.0), circle, episodes=2)
    # a first-order loop of gain k trails a ramp by 1 / k, whatever its delay
    assert trials.tracking_lag_s == pytest.approx([0.25, 0.25], rel=0.03)
    assert headline_metric(trials) == pytest.approx(trials.tracking_px.mean(), rel=1e-6)
    assert np.isnan(trials.bound_s).all()


def test_the_gaze_fix_is_right_once_the_eyes_have_settled():
    trials = run_trials(KnowsTheWay(3), STEP, episodes=2)
    # a pixel of vergence error is 17 mm of depth at 1 m; the way is exact to far less
    assert (trials.fix_error_at_settling_m() < 1e-6).all()
    assert (trials.fix_error_m[0] > 1e-2).all()


def test_energy_and_peak_are_those_of_the_one_command():
    trials = run_trials(KnowsTheWay(3), STEP, episodes=2)
    speed = KnowsTheWay(3).action * ideal_head().limits.velocity[3:]
    assert trials.peak_rad_s == pytest.approx([np.abs(speed).max()] * 2)
    assert trials.energy == pytest.approx([np.sum(speed**2) * PERIOD_S] * 2)


def test_a_target_that_stays_out_of_sight_is_lost():
    class LooksAway:
        def predict(self, observation, state=None, episode_start=None, deterministic=True):
            return np.full((len(observation), 4), 1.0), state

    trials = run_trials(LooksAway(), ToyScenario("random", duration_s=1.5), episodes=3)
    assert trials.lost.all()
    assert np.isnan(trials.settle_s()).all()
    assert np.isfinite(trials.steady_px).all()


def test_the_observations_of_the_first_trials_are_kept_on_request():
    trials = run_trials(ibvs(), RANDOM, episodes=5, batch_size=2, observed_trials=3)
    assert trials.observation.shape == (96, 3, 27)
    assert run_trials(ibvs(), RANDOM, episodes=2).observation.shape[1] == 0


def test_predict_is_timed_per_head():
    ticks = iter(range(10**6))
    # every reading of this clock is a microsecond later than the one before
    trials = run_trials(ibvs(), RANDOM, episodes=4, clock_ns=lambda: 1000 * next(ticks))
    assert trials.predict_us == pytest.approx(1.0 / 4)


def test_an_argument_that_cannot_be_is_refused():
    for name in ("episodes", "batch_size"):
        with pytest.raises(ConfigurationError, match=f"{name}: expected at least 1"):
            run_trials(ibvs(), RANDOM, **{"episodes": 2, name: 0})


def test_actions_of_another_shape_are_refused():
    class Single:
        def predict(self, observation, state=None, episode_start=None, deterministic=True):
            return np.zeros(4), state

    with pytest.raises(ConfigurationError, match=r"action: expected shape \(2, 4\)"):
        run_trials(Single(), RANDOM, episodes=2)
