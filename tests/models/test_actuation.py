"""Actuation: couplings between joints, and the fixation that they allow."""

import dataclasses

import numpy as np
import pytest
from scipy.optimize import least_squares

from tests.heads import MOVING, head_of, text_of
from tests.naming import refused
from vergence.models import load_head, parse_head

POINTS = np.array([[0.1, -0.05, 0.6], [-0.2, 0.1, 1.2], [0.0, 0.0, 2.5], [0.05, 0.1, 0.35]])


def test_the_article_s_heads_have_a_motor_a_joint():
    for head in map(load_head, ("simulated", "physical")):
        own = head.actuation
        assert own.direct
        assert own.names == head.joints[3:]
        for name in ("lower", "upper", "velocity", "acceleration"):
            np.testing.assert_array_equal(getattr(own, name), getattr(head.limits, name))


def test_a_joint_that_both_eyes_share_has_one_motor_and_a_fixed_pair_none():
    actuation = head_of("common").actuation
    assert actuation.names == ("pan", "tilt")
    assert not actuation.direct
    q = actuation.joints_of([0, 0, 0, 0.1, 0.2, 0, 0])
    np.testing.assert_array_equal(q, [0, 0, 0, 0.1, 0.2, 0.1, 0.2])
    np.testing.assert_allclose(actuation.actuators_of(q), [0, 0, 0, 0.1, 0.2, 0, 0], atol=1e-15)
    pair = head_of("pair")
    assert pair.actuation.count == 0
    refused("a fixed pair", pair.fixate, [0.0, 0.0, 1.0])


def test_version_and_vergence_move_both_pans_within_their_limits():
    head = head_of("tied")
    q = head.actuation.joints_of([0, 0, 0, 0.1, 0.2, 0.3, 0.0])
    np.testing.assert_allclose(q[3:], [0.1, 0.35, 0.1, 0.05], atol=1e-15)
    back = head.actuation.actuators_of(q)
    np.testing.assert_allclose(back, [0, 0, 0, 0.1, 0.2, 0.3, 0.0], atol=1e-15)
    # the joints' own limits are all that the actuators reach
    np.testing.assert_allclose(head.limits.upper[4], 0.9 + 0.6)
    np.testing.assert_allclose(head.limits.lower[6], -0.9 - 0.6)
    limits = parse_head(text_of("tied") + "[joint_offsets_rad]\nleft_pan = 0.1\n").limits
    np.testing.assert_allclose([limits.lower[4], limits.upper[4]], [0.1 - 0.9, 0.1 + 0.9 + 0.6])
    inside = head.actuation.joints_of([0, 0, 0, 0, 0.8, 1.1, 0])
    beyond = head.actuation.joints_of([0, 0, 0, 0, 0.8, -0.1, 0])  # eyes that look apart
    assert head.reaches(inside)
    assert not head.reaches(beyond)
    assert head.reaches(inside, margin=0.05)
    assert not head.reaches(inside, margin=0.2)
    assert not head.reaches(inside + 0.01 * np.eye(7)[3])  # one eye alone cannot look down


@pytest.mark.parametrize("name", MOVING)
def test_fixation_leaves_the_least_sum_of_squares(name):
    head = head_of(name)
    actuation = head.actuation
    for point in POINTS:
        q = head.fixate(point)
        own = actuation.actuators_of(q)[3 : 3 + actuation.count]
        np.testing.assert_allclose(actuation.joints_of(actuation.actuators_of(q)), q, atol=1e-12)

        def error(actuators, point=point):
            joints = actuation.joints_of(np.r_[[0.0] * 3, actuators, [0.0] * (4 - actuation.count)])
            return (head.project(joints, point, distorted=False) - head.cameras.principal).ravel()

        best = least_squares(error, np.zeros(actuation.count), xtol=1e-15, ftol=1e-15, gtol=1e-15)
        np.testing.assert_allclose(own, best.x, atol=2e-6)
        np.testing.assert_allclose(head.least_error(point).ravel(), error(own), atol=1e-9)
        assert error(own) @ error(own) <= 2.0 * best.cost * (1.0 + 1e-9) + 1e-12


def test_an_actuator_may_have_its_own_lag_and_steps_but_not_do_what_others_do():
    own = {"lag_s": [np.nan, 0.06, np.nan], "backlash_rad": [0.0, 0.002, 0.0]}
    head = head_of("tied")
    actuation = head.replace(actuators=dataclasses.replace(head.actuators, **own)).actuation
    np.testing.assert_array_equal(actuation.lag_ratio, [1, 1, 1, 1, 2, 1, 1])
    np.testing.assert_array_equal(actuation.backlash, [0, 0, 0, 0, 0.002, 0, 0])
    np.testing.assert_array_equal(actuation.angle_step[3:], [0.0005, 0.0005, 0.0005, 0.0])
    same = np.repeat(head.actuators.matrix[:, :1], 3, axis=1)
    refused("independent columns", dataclasses.replace, head.actuators, matrix=same)
