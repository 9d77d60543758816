"""By how much the speeds that servos tell are older than their angles, and what follows from it."""

from itertools import pairwise

import numpy as np
import pytest

from tests.controllers.prediction.observed import predictor_of, record, turns
from vergence import load_head
from vergence.controllers.prediction.state import PREDICTOR_STATE, PREDICTOR_STATE_SIZE
from vergence.models.parts import FloatArray

HEAD = load_head("simulated")
PERIOD_S = HEAD.timing.period_s


def filtered(speeds: FloatArray) -> FloatArray:
    """Through a low-pass of first order of 60 ms, speeds going straight from reading to reading."""
    reported, shown = [speeds[0]], np.exp(-PERIOD_S / 0.06)
    for before, now in pairwise(speeds):
        reported.append(shown * reported[-1] + (1.0 - shown) * 0.5 * (before + now))
    return np.array(reported)


def late(speeds: FloatArray) -> FloatArray:
    """Three periods later."""
    return np.vstack([np.tile(speeds[0], (3, 1)), speeds[:-3]])


def predicted_state(row: np.ndarray) -> np.ndarray:
    return row[:PREDICTOR_STATE_SIZE].view(PREDICTOR_STATE)[0]


READINGS = {
    "prompt": (lambda speeds: speeds, 0.0), "filtered": (filtered, 0.06),
    "late": (late, 3.0 * PERIOD_S), "in other units": (lambda speeds: 60.0 * speeds, None),
    "none": (np.zeros_like, None),
}  # fmt: skip


@pytest.mark.parametrize("reading", READINGS)
def test_speeds_are_observed_and_their_delay_is_found_however_they_are_read(reading: str) -> None:
    spoilt, delay_s = READINGS[reading]
    way = record(HEAD, turns(HEAD, 70, speed=3.0, time_s=0.12))
    speeds = np.array([one.velocities for one in way.observations])
    predictor = predictor_of(HEAD)
    state = predictor.initial()
    observed = []
    for seen, reported in zip(way.observations, spoilt(speeds), strict=True):
        predictor.update(seen._replace(velocities=reported), state)
        estimated = predicted_state(state)
        observed.append(estimated["joints"]["velocity"].copy())
    if delay_s is not None:
        assert estimated["observer"]["delay_s"] == pytest.approx(delay_s, abs=0.003)
    off = np.abs(np.array(observed) - speeds[:, 3:])[20:, [1, 3]]
    assert np.sqrt((off**2).mean()) < 0.02  # of 3 rad/s to and fro


def test_a_damaged_angle_makes_no_speed_that_no_actuator_has() -> None:
    predictor = predictor_of(HEAD)
    state = predictor.initial()
    for k, seen in enumerate(record(HEAD, turns(HEAD, 40)).observations):
        spoilt = np.where(k == 20, 1e7, seen.positions)
        predictor.update(seen._replace(positions=spoilt), state)
        fastest = 3.0 * HEAD.actuation.velocity[3:]
        assert (np.abs(predicted_state(state)["joints"]["velocity"]) <= fastest).all()
