"""Errors of readings that follow a rule are found along with the head."""

import numpy as np
import pytest

import vergence
from vergence.calibration.head.adjust import HeadAdjustment, Weights
from vergence.calibration.head.prior import spreads_of
from vergence.calibration.head.reading_terms import ReadingTerms
from vergence.calibration.head.simulated import record

STEP = 1e-6


@pytest.mark.parametrize("name", ["physical", "icub"])
def test_derivatives_by_the_rules_numbers_are_those_of_differences(name):
    head = vergence.load_head(name).replace(sensor={"encoder_resolution_rad": 0.0})
    if head.actuators is not None:
        head = head.replace(actuators={"encoder_resolution_rad": np.zeros(head.actuation.count)})
    seen = record(head, head, np.random.default_rng(1), poses=6, frames=2)
    terms = ReadingTerms.of_frames(head, seen.frames, ("play", "harmonics"))
    problem = HeadAdjustment(head, spreads_of(head), seen.frames, terms=terms)
    assert not problem.joints.own.any()  # so that no errors follow
    values = np.random.default_rng(2).uniform(0.001, 0.01, len(terms.names))
    state = problem.start(seen.boards)._replace(terms=values)
    weights = Weights.of(seen.frames.seen)
    p = problem.common - len(values)
    slope = problem.linearised(state, weights).slope[p : problem.common]
    costs = [
        [
            problem.linearised(state._replace(terms=values + s * row), weights).cost
            for s in (STEP, -STEP)
        ]
        for row in np.eye(len(values))
    ]
    differences = np.array([(more - less) / (4.0 * STEP) for more, less in costs])
    np.testing.assert_allclose(slope, differences, rtol=1e-5, atol=1e-6 * np.abs(slope).max())
