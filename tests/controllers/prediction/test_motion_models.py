"""Targets that move: carried on through the delay; those that rest, stop or are lost."""

import numpy as np

from tests.controllers.prediction.observed import PLACE, predict, predictor_of, record, resting
from tests.naming import named
from vergence import load_head

HEAD = load_head("simulated")
PERIOD_S = HEAD.timing.period_s
VELOCITY = np.array([0.25, 0.05, 0.0])


def moving(time_s: float) -> np.ndarray:
    return np.array(PLACE) + (time_s - 0.5) * VELOCITY


def goals(times_s: np.ndarray, target) -> np.ndarray:
    """(n, 4) angles that fixate a target at some times, rad."""
    return np.array([HEAD.fixate(target(time), HEAD.rest()[:3])[3:] for time in times_s])


def seen(target, steps=120, spoil=None, noise_px=0.02):
    """Predicted goals (steps, 4), their rates (steps, 4), and when they are those, s."""
    way = record(HEAD, np.zeros((steps, 4)), target=target, noise_px=noise_px, spoil=spoil)
    every = predict(predictor_of(HEAD, moving=True), way)
    # a little late, so that a response that is later than likely is none that oscillates
    ahead = np.array([one.response_latency_s + 0.5 * one.response_latency_sd_s for one in every])
    return (
        np.array([one.positions + one.angle_error for one in every]),
        np.array([one.goal_rates for one in every]),
        np.arange(steps) * PERIOD_S + ahead,
    )


def test_a_steady_target_is_predicted_without_lag() -> None:
    predicted, rates, times = seen(moving)
    expected = goals(times, moving)
    # 0.28 rad/s through 80 ms are 22 mrad
    assert np.abs(predicted - expected)[60:].max() < 0.002
    true = (goals(times + 1e-4, moving) - expected) / 1e-4
    assert np.abs(rates - true)[60:].max() < 0.03


def test_a_target_that_accelerates_is_predicted_too() -> None:
    def swinging(time_s):
        return np.array(PLACE) + np.array([0.2 * np.sin(2.5 * time_s), 0.0, 0.0])

    predicted, _, times = seen(swinging, 240)
    # unpredicted it would be up to 45 mrad behind
    assert np.abs(predicted - goals(times, swinging))[90:].max() < 0.005


def test_a_target_at_rest_has_no_rate_whatever_the_noise() -> None:
    # noise far beyond what the head says has to be known first
    for noise_px, known in [(0.02, 0), (0.3, 0), (0.5, 0), (1.0, 60)]:
        with named(noise_px):
            _, rates, _ = seen(resting, noise_px=noise_px)
            assert not rates[known:].any()


def test_a_target_that_stops_or_sets_out_is_noticed() -> None:
    seen_s = 0.5 + HEAD.timing.latency_s

    def stops(time_s):
        return moving(min(time_s, 0.5))

    def sets_out(time_s):
        return moving(max(time_s, 0.5))

    for target in (stops, sets_out):
        with named(target.__name__):
            predicted, rates, times = seen(target, 130)
            expected = goals(times, target)
            assert np.abs(predicted - expected)[times > seen_s + 0.15].max() < 0.003
            at_rest = times > seen_s + 0.15 if target is stops else times < seen_s
            assert np.abs(rates[at_rest]).max() <= (0.02 if target is stops else 0.0)


def test_a_jump_is_no_motion() -> None:
    def jumps(time_s):
        return np.array(PLACE) + (0.1 if time_s > 0.4 else 0.0)

    predicted, rates, times = seen(jumps)
    assert not rates.any()
    assert np.abs(predicted - goals(times, jumps))[70:].max() < 0.001


def test_an_unseen_target_goes_on_for_a_while_and_is_sought_where_it_was_seen_last() -> None:
    def lost(exposed, error):
        return np.full((2, 2), np.nan) if exposed > 0.5 else error

    predicted, rates, times = seen(moving, 170, lost)
    expected = goals(times, moving)
    soon = (times > 0.6) & (times < 0.75)
    # it is followed on, not faster than it went
    assert np.abs(predicted - expected)[soon].max() < 0.02
    last = goals(np.array([0.5]), moving)[0]
    long = (times > 1.25) & (times < 1.4)
    assert np.abs(predicted - last)[long].max() < 0.02
    assert np.abs(rates[long]).max() < 0.1


def test_one_eye_tells_the_other_where_a_moving_target_is() -> None:
    def half(exposed, error):
        if exposed > 0.5:
            error[1] = np.nan
        return error

    predicted, _, times = seen(moving, 150, half)
    expected = goals(times, moving)
    late = times > 1.0
    assert np.abs(predicted - expected)[late][:, :2].max() < 0.002
    # at the depth that both saw last
    assert np.abs(predicted - expected)[late][:, 2:].max() < 0.02


def test_a_predictor_of_targets_at_rest_knows_no_rates() -> None:
    way = record(HEAD, np.zeros((90, 4)), target=moving)
    assert not np.array([one.goal_rates for one in predict(predictor_of(HEAD), way)]).any()
