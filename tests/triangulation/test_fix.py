"""Crossing of two lines of sight: exactness, batches, skew rays, and cases without an answer."""

import csv
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from tests.naming import named
from tests.triangulation.conftest import settled_angles
from vergence import Fix, HeadModel, ModelErrors, Noise, load_head, triangulate_gaze
from vergence.triangulation import triangulate_views

DATA = Path(__file__).resolve().parents[1] / "data"
MM = 1e-3
NANOMETRE = 1e-9  # the 1e-6 mm that exactness means here: four orders above rounding


def table_3() -> NDArray[np.float64]:
    with (DATA / "table3_simulated_static_points.csv").open(encoding="utf-8", newline="") as file:
        rows = [[float(row[f"{axis}_mm"]) for axis in "xyz"] for row in csv.DictReader(file)]
    return MM * np.array(rows)


def workspace(rng: np.random.Generator, shape: tuple[int, ...]) -> NDArray[np.float64]:
    """Points that both eyes can look at, 0.4 to 2.5 m ahead and up to 25 degrees aside."""
    z = rng.uniform(0.4, 2.5, shape)
    slopes = rng.uniform(-0.45, 0.45, (*shape, 2))
    return np.concatenate([slopes * z[..., None], z[..., None]], axis=-1)


def same(a: Fix, b: Fix) -> bool:
    return all(
        np.array_equal(x, y, equal_nan=x.dtype != np.bool_) for x, y in zip(a, b, strict=True)
    )


def test_gaze_and_views_from_eyes_at_rest_find_the_points_of_table_3(head: HeadModel) -> None:
    points = table_3()
    assert points.shape == (21, 3)
    q = np.zeros(7)
    for fix in (
        triangulate_gaze(head, head.fixate(points)),
        triangulate_views(head, q, head.project(q, points)),
    ):
        assert fix.valid.all()
        assert np.abs(fix.point - points).max() < NANOMETRE
        assert fix.gap.max() < NANOMETRE


_HEADS = {name: load_head(name) for name in ("simulated", "physical")}


@pytest.mark.slow
@given(
    name=st.sampled_from(sorted(_HEADS)),
    slope=st.tuples(st.floats(-0.45, 0.45), st.floats(-0.45, 0.45)),
    depth=st.floats(0.3, 3.0),
    aside=st.lists(st.floats(-0.1, 0.1), min_size=7, max_size=7),
)
def test_views_undo_projection_at_any_posture(name, slope, depth, aside) -> None:
    head = _HEADS[name]
    point = depth * np.array([*slope, 1.0])
    q = head.fixate(point) + aside
    fix = triangulate_views(head, q, head.project(q, point))
    assert fix.valid
    # a lens inverted to 1e-13 of its normalised radius turns depth by Z^2 / b times as much
    assert fix.point == pytest.approx(point, abs=1e-9)


@given(neck=st.tuples(*[st.floats(-0.5, 0.5)] * 3))
def test_the_neck_moves_the_base_frame_and_not_the_fix_in_it(neck) -> None:
    head = _HEADS["simulated"]
    point = np.array([0.1, -0.2, 0.8])
    turned = head.fixate(point, neck)
    assert same(triangulate_gaze(head, turned), triangulate_gaze(head, head.fixate(point)))


def test_a_population_against_a_batch_of_angles_is_the_loop_over_both(
    head: HeadModel, errors: ModelErrors, rng
) -> None:
    heads = head.perturbed(rng, errors, (3, 1))
    points = workspace(rng, (4,))
    q = head.fixate(points)
    pixels = head.project(q, points) + rng.normal(0.0, 5.0, (4, 2, 2))
    pixel_px, joint_rad = rng.uniform(0.01, 0.1, (4, 2, 2)), rng.uniform(1e-5, 1e-4, (4, 7))
    noise = Noise(pixel_px=pixel_px, joint_rad=joint_rad)
    for call, seen in ((triangulate_gaze, False), (triangulate_views, True)):
        with named(call.__name__):
            together = call(heads, q, *[pixels] * seen, noise)
            assert together.point.shape == (3, 4, 3)
            assert together.gap.shape == together.valid.shape == (3, 4)
            assert together.covariance.shape == (3, 4, 3, 3)
            for i, j in np.ndindex(3, 4):
                own = Noise(pixel_px=pixel_px[j], joint_rad=joint_rad[j])
                alone = call(heads[i, 0], q[j], *[pixels[j]] * seen, own)
                assert same(alone, Fix(*(part[i, j] for part in together)))


def test_fix_and_gap_satisfy_the_definition_on_skew_axes(
    head: HeadModel, errors: ModelErrors, rng
) -> None:
    points = workspace(rng, (40,))
    heads = head.perturbed(rng, errors, 40)
    fix = triangulate_gaze(heads, head.fixate(points))
    assert fix.valid.all()
    assert fix.gap.min() > 1e-6  # they are skew
    poses = heads.camera_poses(head.fixate(points))
    origin, axis = poses[..., :3, 3], poses[..., :3, 2]
    normal = np.cross(axis[:, 0], axis[:, 1])
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    distance = np.abs(((origin[:, 1] - origin[:, 0]) * normal).sum(axis=-1))
    assert fix.gap == pytest.approx(distance, abs=NANOMETRE)
    # the midpoint is half a gap from either axis
    away = fix.point[:, None] - origin
    beside = away - (away * axis).sum(axis=-1, keepdims=True) * axis
    assert np.linalg.norm(beside, axis=-1) == pytest.approx(
        np.repeat(0.5 * distance[:, None], 2, axis=1), abs=NANOMETRE
    )


def has_no_answer(fix: Fix) -> bool:
    """Marked as such, all its numbers nan and none of them infinite."""
    numbers = (fix.point, fix.gap, fix.covariance)
    return not fix.valid.any() and all(np.isnan(part).all() for part in numbers)


def turned(left_pan: float, right_pan: float) -> NDArray[np.float64]:
    """Angles of eyes that only pan; a positive pan looks left."""
    return np.array([0.0, 0.0, 0.0, 0.0, left_pan, 0.0, right_pan])


def test_axes_that_are_nearly_parallel_or_cross_behind_an_eye_have_no_answer(
    head, simulated
) -> None:
    parallel = [(0.0, angle) for angle in (0.0, 1e-12, 1e-8, 0.9e-4)]
    # diverging; and both far to the left, the left one even farther, so that it is behind that eye
    for pans in (*parallel, (0.1, -0.1), (0.9, 0.5)):
        with named(pans):
            assert has_no_answer(triangulate_gaze(head, turned(*pans)))
    fix = triangulate_gaze(simulated, turned(0.0, 2e-4))  # but these converge
    assert fix.valid
    # 92 mm of baseline; a relative 1e-6 is the rounding of the squared sine of 2e-4
    assert fix.point[2] == pytest.approx(0.092 / np.tan(2e-4) + 0.0138, rel=1e-6)


def test_an_eye_that_does_not_see_or_an_angle_of_nan_leaves_no_answer_for_that_element(
    head: HeadModel, rng
) -> None:
    points = workspace(rng, (6,))
    q = head.fixate(points)
    pixels = head.project(q, points)
    for element, (eye, axis) in enumerate(np.ndindex(2, 2)):
        pixels[element, eye, axis] = np.nan
    fix = triangulate_views(head, q, pixels)
    assert fix.valid.tolist() == [False] * 4 + [True] * 2
    assert has_no_answer(Fix(*(part[:4] for part in fix)))
    assert np.abs(fix.point - points)[4:].max() < NANOMETRE
    q[0, 5] = np.nan
    assert has_no_answer(triangulate_gaze(head, q[0]))


@given(pans=st.tuples(*[st.floats(-1.5, 1.5)] * 2), tilts=st.tuples(*[st.floats(-1.5, 1.5)] * 2))
def test_nothing_is_ever_infinite(pans, tilts) -> None:
    q = np.array([0.0, 0.0, 0.0, tilts[0], pans[0], tilts[1], pans[1]])
    fix = triangulate_gaze(_HEADS["simulated"], q, Noise(pixel_px=0.1, joint_rad=1e-3))
    assert not any(np.isinf(part).any() for part in (fix.point, fix.gap, fix.covariance))
    assert np.isfinite(fix.point).all() == bool(fix.valid)


def test_settled_gaze_and_views_are_one_computation_whatever_the_model_errors(
    head: HeadModel, errors: ModelErrors, rng
) -> None:
    heads = head.perturbed(rng, errors, 60)
    points = workspace(rng, (60,))
    q = settled_angles(heads, head, points)
    pixels = heads.project(q, points)
    gaze, views = triangulate_gaze(head, q), triangulate_views(head, q, pixels)
    assert np.abs(gaze.point - points).max() > 1 * MM  # the errors do matter
    assert np.abs(gaze.point - views.point).max() < 1e-9 * MM
