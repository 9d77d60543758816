"""Heads, poses and the exact actuator that the tests of the models share."""

import csv
from pathlib import Path

import numpy as np
import pytest

from vergence.models import HeadModel, ModelErrors, load_head

DATA = Path(__file__).resolve().parents[1] / "data"

ERRORS = ModelErrors(
    link_m=1e-3, coaxiality_rad=0.01, joint_offset_rad=0.02, head_eye_rad=0.01, head_eye_m=1e-3,
    focal_relative=0.01, principal_px=5.0, distortion=0.01,
)  # fmt: skip


@pytest.fixture
def head() -> HeadModel:
    """A head drawn about the preset with distortion: none of its numbers is a round one."""
    return load_head("physical").perturbed(np.random.default_rng(7), ERRORS)


@pytest.fixture
def simulated() -> HeadModel:
    return load_head("simulated")


@pytest.fixture
def physical() -> HeadModel:
    return load_head("physical")


@pytest.fixture
def errors() -> ModelErrors:
    """Errors a few times those of a carelessly built head."""
    return ERRORS


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(20)


@pytest.fixture
def random_poses(rng):
    def draw(head: HeadModel, count: int) -> np.ndarray:
        return rng.uniform(head.limits.lower, head.limits.upper, (count, 7))

    return draw


@pytest.fixture
def table_points():
    """The points of the article's tables, (n, 3) in N, metres, by the number of the table."""

    def read(table: int) -> np.ndarray:
        (path,) = DATA.glob(f"table{table}_*_points.csv")
        with path.open(encoding="utf-8", newline="") as file:
            rows = [[float(row[f"{axis}_mm"]) for axis in "xyz"] for row in csv.DictReader(file)]
        return np.array(rows) / 1000.0

    return read


@pytest.fixture
def exact_actuator():
    """Advance v' = clip((u - v) / tau, +-a_max), q' = v by a closed form."""

    def advance(q, v, u, time_s, lag_s, acceleration):
        gap = u - v
        clamped_s = np.clip(np.abs(gap) / acceleration - lag_s, 0.0, time_s)
        slope = np.sign(gap) * acceleration
        q = q + v * clamped_s + 0.5 * slope * clamped_s**2
        v = v + slope * clamped_s
        gap = u - v
        rest_s = time_s - clamped_s
        decay = -np.expm1(-rest_s / lag_s)
        return q + u * rest_s - gap * lag_s * decay, v + gap * decay

    return advance
