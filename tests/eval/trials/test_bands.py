"""Bands of actuators: as wide as both error circles allow, and not noticeably wider."""

import numpy as np
import pytest
from scipy.optimize import minimize

from tests.heads import MOVING, head_of
from vergence.eval.trials.bands import actuator_settling_bands, eye_settling_bands
from vergence.models.head import HeadModel

POINT = np.array([0.1, 0.05, 0.8])


def half_bands_of(head: HeadModel, find=actuator_settling_bands) -> tuple[np.ndarray, np.ndarray]:
    goal, half_band = np.full((2, 1, 4), np.nan)
    find(head.packed[None], head.packed, POINT[None], 1.0, goal, half_band)
    count = head.actuation.count
    assert np.isfinite(goal[0, :count]).all()
    return goal[0, :count], half_band[0, :count]


def furthest(head: HeadModel, goal: np.ndarray, k: int) -> float:
    """Largest error of actuator k with both eyes within 1 px, by constrained optimisation."""
    scale = 1.0 / head.cameras.focal.mean()

    def errors(own: np.ndarray) -> np.ndarray:
        actuators = np.zeros(7)
        actuators[3 : 3 + len(own)] = own
        q = head.actuation.joints_of(actuators)
        return head.project(q, POINT) - head.cameras.principal

    least = errors(goal)
    left = {
        "type": "ineq",
        "fun": lambda x: 1.0 - np.sum((errors(goal + scale * x) - least) ** 2, axis=-1),
    }
    found = [
        minimize(lambda x, s=sign: -s * x[k], np.zeros(len(goal)), constraints=left, tol=1e-10)
        for sign in (1.0, -1.0)
    ]
    return scale * max(abs(one.x[k]) for one in found)


def test_the_band_of_an_actuator_is_the_widest_that_both_circles_allow():
    for shape in MOVING:
        head = head_of(shape)
        goal, half_band = half_bands_of(head)
        for k in range(len(goal)):
            true = furthest(head, goal, k)
            # a per cent for the bend of the image
            assert true <= half_band[k] <= 1.01 * true, (shape, k)


def test_eyes_with_two_motors_each_have_the_same_bands_by_either_way():
    head = head_of("panfirst")
    goal, half_band = half_bands_of(head)
    same, wide = half_bands_of(head, eye_settling_bands)
    assert goal == pytest.approx(same, abs=1e-9)
    assert half_band == pytest.approx(wide, rel=1e-4)
