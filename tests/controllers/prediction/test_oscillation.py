"""Half swings that are too many are counted, and what is no swing is not."""

import numpy as np

from tests.naming import named
from vergence import load_head
from vergence.controllers.prediction.oscillation import (
    OSCILLATING_HALF_SWINGS,
    OscillationState,
    decay_count,
    reset_oscillation,
    update_oscillation,
)
from vergence.controllers.prediction.parameters import (
    PREDICTOR_PARAMETERS,
    pack_predictor_parameters,
)
from vergence.controllers.rows import row_layout

HEAD = load_head("physical")
RATE_HZ = HEAD.timing.control_rate_hz
TIME_S = np.arange(round(2.0 * RATE_HZ)) / RATE_HZ
NOISE = 1e-8


def swings(angle, aim=None):
    """The greatest number of swings of a joint at some angles, its goal at others."""
    record = np.zeros(1, dtype=row_layout(OscillationState))[0]
    record["decay_time_s"] = 1.0
    params = pack_predictor_parameters(HEAD).view(PREDICTOR_PARAMETERS)[0]
    reset_oscillation(record, 0, 1, float(angle[0]))
    most = 0.0
    for one, goal in zip(angle, np.zeros_like(angle) if aim is None else aim, strict=True):
        decay_count(record, params.period_s)
        update_oscillation(record, params, 0, 1, float(one), float(goal), NOISE)
        most = max(most, float(record["half_swing_count"]))
    return most


def test_an_eye_that_swings_about_a_goal_at_rest_is_found_within_a_second() -> None:
    for hz in [2.0, 5.0]:
        with named(hz):
            lasting = 0.02 * np.sin(2.0 * np.pi * hz * TIME_S)
            assert swings(lasting[max(1.0, 3.0 / hz) > TIME_S]) > OSCILLATING_HALF_SWINGS


def test_what_dies_away_or_hardly_moves_is_no_swing() -> None:
    for what, motion in {
        "dying": 0.3 - 0.3 * np.exp(-12.0 * TIME_S) * np.cos(20.0 * TIME_S),
        "tremor": 0.001 * np.sin(60.0 * TIME_S), "slow": 0.02 * np.sin(3.0 * TIME_S),
    }.items():  # fmt: skip
        with named(what):
            assert swings(motion) < 0.5


def test_an_eye_that_follows_a_target_to_and_fro_does_not_swing() -> None:
    target = 0.1 * np.sin(2.0 * np.pi * 2.0 * TIME_S)
    late = 0.1 * np.sin(2.0 * np.pi * 2.0 * (TIME_S - 0.02))
    assert swings(late, target) == 0.0
