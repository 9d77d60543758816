"""Latency, lag, acceleration and gain of the actuators are found in one turn of the eyes."""

import numpy as np
import pytest

from tests.controllers.prediction.observed import predict, predictor_of, record, saccades, turns
from vergence import load_head
from vergence.controllers.prediction.predictor import SmithPredictor
from vergence.envs.observation import ObservationLayout

HEAD = load_head("simulated")


@pytest.mark.parametrize(
    ("latency_s", "lag_s", "ratio", "gain", "speed"),
    [
        (0.004, 0.03, 1.0, 1.0, 6.0), (0.0083, 0.03, 0.4, 0.85, 2.5), (0.034, 0.06, 1.2, 0.9, 6.0),
        (0.1, 0.03, 0.7, 1.1, 2.5),
    ],
)  # fmt: skip
def test_one_turn_and_back_tells_how_actuators_answer(latency_s, lag_s, ratio, gain, speed):
    # so fast that the acceleration is at its limit, and so slow that the speed is reached
    commands = turns(HEAD, 75, speed=speed, time_s=0.1)
    way = record(HEAD, commands, latency_s=latency_s, lag_s=lag_s, ratio=ratio, gain=gain)
    last = predict(predictor_of(HEAD), way)[-1]
    assert last.response_latency_s == pytest.approx(latency_s, abs=0.0015)
    assert last.lag_s == pytest.approx(lag_s, rel=0.05)
    assert last.acceleration_ratio == pytest.approx(ratio, rel=0.05)
    assert last.speed_gain[[1, 3]] == pytest.approx(gain, rel=0.02)
    assert last.response_latency_sd_s < 0.003
    assert last.acceleration_sd < 0.1
    assert last.build_up == 0.0


@pytest.mark.parametrize(("build_up", "lag_s"), [(0.4, 0.06), (1.9, 0.025)])
def test_two_turns_tell_a_servo_whose_own_loop_swings(build_up, lag_s) -> None:
    way = record(HEAD, turns(HEAD, 120), latency_s=0.017, lag_s=lag_s, build_up=build_up, gain=0.9)
    last = predict(predictor_of(HEAD), way)[-1]
    assert last.build_up == pytest.approx(build_up, rel=0.15)
    assert last.lag_s == pytest.approx(lag_s, rel=0.1)
    assert last.response_latency_s == pytest.approx(0.017, abs=0.003)


@pytest.mark.parametrize(
    ("rate_hz", "known_s", "true_s"),
    [
        (50.0, 0.0, 0.017), (250.0, 0.0, 0.017), (120.0, 0.2, 0.24), (120.0, 0.15, 0.17),
        (1000.0, 0.2, 0.19),
    ],
)  # fmt: skip
def test_the_latency_is_found_about_the_models_own_at_any_rate(rate_hz, known_s, true_s) -> None:
    timing = {"control_rate_hz": rate_hz, "frame_rate_hz": 50.0, "command_latency_s": known_s}
    head = HEAD.replace(timing=timing)
    way = record(head, turns(head, round(0.8 * rate_hz)), latency_s=true_s, ratio=0.6)
    last = predict(predictor_of(head), way)[-1]
    assert last.response_latency_s == pytest.approx(true_s, abs=0.002)
    assert last.acceleration_ratio == pytest.approx(0.6, rel=0.1)
    assert last.lag_s == pytest.approx(head.timing.lag_s, rel=0.1)


def test_what_is_known_is_less_sure_before_the_first_turn() -> None:
    every = predict(predictor_of(HEAD), record(HEAD, turns(HEAD, 60), ratio=0.5))
    assert every[0].acceleration_sd > 5.0 * every[-1].acceleration_sd
    assert every[0].response_latency_sd_s > 5.0 * every[-1].response_latency_sd_s


def test_what_is_nominal_is_never_doubted() -> None:
    head = HEAD.replace(timing={"command_latency_s": 0.012})
    predictor = SmithPredictor(
        head=head, layout=ObservationLayout.of(head), delay="nominal", lag="nominal"
    )
    way = record(head, turns(head, 60), latency_s=0.03, ratio=0.5, image_delay_s=0.1)
    last = predict(predictor, way)[-1]
    assert last.image_delay_s == pytest.approx(head.timing.latency_s, abs=1e-6)
    assert last.response_latency_s == 0.012
    assert last.lag_s == pytest.approx(head.timing.lag_s)
    assert last.acceleration_ratio == 1.0


@pytest.mark.parametrize("latency_s", [0.0, 0.033])
def test_a_saccade_tells_command_and_feedback_latency_together(latency_s) -> None:
    options = {"command_latency_s": 0.6 * latency_s, "feedback_latency_s": 0.4 * latency_s}
    last = saccades(HEAD, 70, **options).predicted[-1]
    # a build-up that hardly overshoots may stand for some of it
    assert np.abs(last.response_latency_s - latency_s).max() < 0.008
    assert np.abs(np.median(last.response_latency_s) - latency_s) < 0.0025


def test_each_actuator_has_a_gain_of_its_own() -> None:
    gains = np.tile([0.85, 1.15, 0.95, 1.05], (12, 1))
    found = saccades(HEAD, 70, speed_gain=gains).predicted[-1].speed_gain
    # tilts turn less than pans do, and tell less
    assert np.abs(np.median(found, axis=0) - gains[0])[[1, 3]].max() < 0.06
