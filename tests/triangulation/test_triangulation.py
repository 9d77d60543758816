"""Points by two lines of sight: exactness, batches, skew rays, no answers, several fixations.

Their covariances are held against derivatives of the points themselves.
"""

import csv
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from tests.heads import head_of
from tests.models.lenses import LENSES, wide
from tests.naming import named, refused
from vergence import Fix, HeadModel, ModelErrors, Noise, load_head, triangulate_gaze
from vergence.calibration.head.simulated import quantised
from vergence.triangulation import gap_sigma, triangulate_fixations, triangulate_views

DATA = Path(__file__).resolve().parents[1] / "data"
MM = 1e-3
NANOMETRE = 1e-9  # the 1e-6 mm that exactness means here: four orders above rounding
FIXATIONS, PIXEL_PX, JOINT_RAD = 64, 0.05, 1e-4
HEADS = {
    **{name: load_head(name) for name in ("simulated", "physical", "icub")},
    **{left: wide(left, right) for left, right in zip(LENSES, reversed(LENSES), strict=True)},
    **{name: head_of(name) for name in ("tied", "mis", "panfirst")},
}


@pytest.fixture(params=["simulated", "physical"])
def head(request: pytest.FixtureRequest) -> HeadModel:
    return HEADS[request.param]


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(20)


def table_3() -> NDArray[np.float64]:
    with (DATA / "table3_simulated_static_points.csv").open(encoding="utf-8", newline="") as file:
        rows = [[float(row[f"{axis}_mm"]) for axis in "xyz"] for row in csv.DictReader(file)]
    return MM * np.array(rows)


def workspace(rng: np.random.Generator, shape: tuple[int, ...]) -> NDArray[np.float64]:
    """Points that both eyes can look at, 0.4 to 2.5 m ahead and up to 25 degrees aside."""
    z = rng.uniform(0.4, 2.5, shape)
    slopes = rng.uniform(-0.45, 0.45, (*shape, 2))
    return np.concatenate([slopes * z[..., None], z[..., None]], axis=-1)


def careful(head: HeadModel, rng: np.random.Generator, shape: int | tuple[int, ...]) -> HeadModel:
    """Heads built with care: up to 2.5 m their axes still cross ahead of them."""
    errors = ModelErrors(
        link_m=5e-4, coaxiality_rad=3e-3, joint_offset_rad=3e-3, head_eye_rad=3e-3,
        head_eye_m=5e-4, focal_relative=0.01, principal_px=1.0, distortion=0.01,
    )  # fmt: skip
    return head.perturbed(rng, errors, shape)


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


@pytest.mark.slow
@given(
    name=st.sampled_from(["simulated", "physical"]),
    slope=st.tuples(st.floats(-0.45, 0.45), st.floats(-0.45, 0.45)),
    depth=st.floats(0.3, 3.0),
    aside=st.lists(st.floats(-0.1, 0.1), min_size=7, max_size=7),
)
def test_views_undo_projection_at_any_posture(name, slope, depth, aside) -> None:
    head = HEADS[name]
    point = depth * np.array([*slope, 1.0])
    q = head.fixate(point) + aside
    fix = triangulate_views(head, q, head.project(q, point))
    assert fix.valid
    # a lens inverted to 1e-13 of its normalised radius turns depth by Z^2 / b times as much
    assert fix.point == pytest.approx(point, abs=1e-9)


@given(neck=st.tuples(*[st.floats(-0.5, 0.5)] * 3))
def test_the_neck_moves_the_base_frame_and_not_the_fix_in_it(neck) -> None:
    head = HEADS["simulated"]
    point = np.array([0.1, -0.2, 0.8])
    turned = head.fixate(point, neck)
    assert same(triangulate_gaze(head, turned), triangulate_gaze(head, head.fixate(point)))


def test_a_population_against_a_batch_of_angles_is_the_loop_over_both(head, rng) -> None:
    heads = careful(head, rng, (3, 1))
    points = workspace(rng, (4,))
    q = head.fixate(points)
    pixels = head.project(q, points) + rng.normal(0.0, 5.0, (4, 2, 2))
    pixel_px, joint_rad = rng.uniform(0.01, 0.1, (4, 2, 2)), rng.uniform(1e-5, 1e-4, (4, 7))
    noise = Noise(pixel_px=pixel_px, joint_rad=joint_rad)
    for call, seen in ((triangulate_gaze, False), (triangulate_views, True)):
        with named(call.__name__):
            together = call(heads, q, *[pixels] * seen, noise)
            assert together.covariance.shape == (3, 4, 3, 3)
            for i, j in np.ndindex(3, 4):
                own = Noise(pixel_px=pixel_px[j], joint_rad=joint_rad[j])
                alone = call(heads[i, 0], q[j], *[pixels[j]] * seen, own)
                assert same(alone, Fix(*(part[i, j] for part in together)))


def test_fix_and_gap_satisfy_the_definition_on_skew_axes(head, rng) -> None:
    points = workspace(rng, (40,))
    heads = careful(head, rng, 40)
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


def test_axes_that_are_nearly_parallel_or_cross_behind_an_eye_have_no_answer(head) -> None:
    parallel = [(0.0, angle) for angle in (0.0, 1e-12, 1e-8, 0.9e-4)]
    # diverging; and both far to the left, the left one even farther, so that it is behind that eye
    for pans in (*parallel, (0.1, -0.1), (0.9, 0.5)):
        with named(pans):
            assert has_no_answer(triangulate_gaze(head, turned(*pans)))
    fix = triangulate_gaze(HEADS["simulated"], turned(0.0, 2e-4))  # but these converge
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
    fix = triangulate_gaze(HEADS["simulated"], q, Noise(pixel_px=0.1, joint_rad=1e-3))
    assert not any(np.isinf(part).any() for part in (fix.point, fix.gap, fix.covariance))
    assert np.isfinite(fix.point).all() == bool(fix.valid)


def test_a_fixed_pair_locates_by_its_images_and_not_by_gaze():
    head, point = head_of("pair"), np.array([0.05, -0.1, 0.7])
    pixels = head.project(np.zeros(7), point)
    fix = triangulate_views(head, np.zeros(7), pixels)
    assert fix.point == pytest.approx(point, abs=NANOMETRE)
    by_pixels = triangulate_views(head, np.zeros(7), pixels, Noise(pixel_px=0.05)).covariance
    assert fix.covariance == pytest.approx(by_pixels, rel=1e-12)
    refused("triangulate_gaze: .*'pair', a fixed pair: tri", triangulate_gaze, head, np.zeros(7))


def looked_at(head: HeadModel, point: np.ndarray, rng: np.random.Generator):
    """Readings and pixels of fixations whose angles differ by up to 0.3 degrees."""
    own = head.actuation
    angles = np.tile(own.actuators_of(head.fixate(point)), (FIXATIONS, 1))
    angles[:, 3:] += rng.uniform(-0.005, 0.005, (FIXATIONS, 4)) * (own.upper > own.lower)[3:]
    q = own.joints_of(angles)
    pixels = head.project(q, point) + PIXEL_PX * rng.standard_normal((FIXATIONS, 2, 2))
    return quantised(head, q), pixels


@pytest.mark.slow
@pytest.mark.parametrize("name", ["physical", "icub"])
def test_several_fixations_are_as_sure_as_they_are_said_to_be_and_surer_than_a_mean(name, rng):
    head, squares, errors, means = HEADS[name], [], [], []
    for point in rng.uniform([-0.2, -0.1, 0.6], [0.2, 0.1, 2.0], (40, 3)):
        q, pixels = looked_at(head, point, rng)
        fix = triangulate_fixations(head, q, pixels, Noise(pixel_px=PIXEL_PX))
        error = fix.point - point
        squares.append(error @ np.linalg.solve(fix.covariance, error) / 3.0)
        errors.append(error[2] / point[2])
        means.append(triangulate_views(head, q, pixels).point[:, 2].mean() / point[2] - 1.0)
    # of 120 numbers, the mean square deviates by 0.13
    assert 0.6 < np.mean(squares) < 1.4
    assert np.std(errors) < np.std(means)


def test_several_fixations_with_exact_encoders_and_pixels_give_the_point():
    head, point = HEADS["simulated"], np.array([0.1, -0.05, 1.2])
    q = head.fixate(point + [[0.0, 0.0, 0.0], [0.01, 0.0, 0.0], [0.0, 0.01, 0.1]])
    fix = triangulate_fixations(head, q, head.project(q, point))
    np.testing.assert_allclose(fix.point, point, atol=1e-7)


def test_fixations_in_which_an_eye_sees_nothing_do_not_count(rng):
    head = HEADS["physical"]
    q, pixels = looked_at(head, np.array([0.0, 0.0, 1.0]), rng)
    first = triangulate_fixations(head, q[:40], pixels[:40])
    pixels[40:, 1] = np.nan
    assert np.array_equal(triangulate_fixations(head, q, pixels).point, first.point)
    said = "both eyes see the point, got none in 64"
    refused(said, triangulate_fixations, head, q, np.full_like(pixels, np.nan))


# noise

POINT = np.array([0.1, -0.1, 0.7])


def propagated(point_of, shape: tuple[int, ...], step: float, sigma: float) -> np.ndarray:
    """Covariance of a point by central differences in inputs with one standard deviation."""
    nudges = step * np.eye(np.prod(shape)).reshape(-1, *shape)
    slopes = (point_of(nudges) - point_of(-nudges)) / (2.0 * step)
    return sigma**2 * np.einsum("ni,nj->ij", slopes, slopes)


def assert_equal(covariance: np.ndarray, expected: np.ndarray) -> None:
    assert expected.max() > 0.0
    np.testing.assert_allclose(covariance, expected, rtol=1e-5, atol=1e-6 * expected.max())


@pytest.mark.parametrize("name", HEADS)
def test_covariances_are_those_of_a_fixs_derivatives_by_pixels_and_actuators(name):
    head = HEADS[name]
    # the eyes look beside the target, so that the interaction of both axes counts
    q = head.fixate(POINT + [0.05, 0.05, 0.0])
    pixels, actuators = head.project(q, POINT), head.actuation.actuators_of(q)
    by_pixels = propagated(
        lambda by: triangulate_views(head, q, pixels + by, Noise()).point, (2, 2), 1e-3, PIXEL_PX
    )
    noise = Noise(pixel_px=PIXEL_PX)
    assert_equal(triangulate_views(head, q, pixels, noise).covariance, by_pixels)

    def turned(by: np.ndarray) -> np.ndarray:
        return head.actuation.joints_of(actuators + by)

    by_joints = propagated(
        lambda by: triangulate_views(head, turned(by), pixels, Noise()).point, (7,), 1e-6, JOINT_RAD
    )
    both = triangulate_views(head, q, pixels, Noise(pixel_px=PIXEL_PX, joint_rad=JOINT_RAD))
    assert_equal(both.covariance, by_pixels + by_joints)
    assert both.sigma == pytest.approx(np.sqrt(np.diag(both.covariance)), rel=1e-15)
    by_joints = propagated(
        lambda by: triangulate_gaze(head, turned(by), Noise()).point, (7,), 1e-6, JOINT_RAD
    )
    assert_equal(triangulate_gaze(head, q, Noise(joint_rad=JOINT_RAD)).covariance, by_joints)


def settled_angles(head: HeadModel, point: np.ndarray, noise_px: np.ndarray) -> np.ndarray:
    """Angles at which noisy detections of a point sit on the principal points.

    That is what a loop does with detections that are off by a constant: Newton's method.
    """
    q = np.broadcast_to(head.fixate(point), (len(noise_px), 7)).copy()
    for _ in range(8):
        error = head.undistort(head.project(q, point) + noise_px) - head.cameras.principal
        seen = head.project(q, point, distorted=False)
        inverse = np.linalg.inv(head.camera_poses(q))
        depth = inverse[..., 2, :3] @ point + inverse[..., 2, 3]
        J = head.image_jacobian(q, seen, depth)
        for eye in range(2):
            part = slice(3 + 2 * eye, 5 + 2 * eye)
            q[..., part] -= np.linalg.solve(J[..., eye, :, part], error[..., eye, :, None])[..., 0]
    return q


@pytest.mark.parametrize("point", [(0.23, -0.1, 0.5), (0.0, -0.1, 2.5)], ids=str)
def test_pixel_noise_of_gaze_reaches_the_point_through_the_settled_loop(head, point):
    expected = propagated(
        lambda by: triangulate_gaze(head, settled_angles(head, point, by), Noise()).point,
        (2, 2), 1e-3, PIXEL_PX,
    )  # fmt: skip
    fix = triangulate_gaze(head, head.fixate(point), Noise(pixel_px=PIXEL_PX))
    assert_equal(fix.covariance, expected)


def test_noise_of_a_head_is_that_of_its_detector_its_encoders_and_their_play(head):
    noise = Noise.of(head)
    assert np.all(noise.pixel_px == head.sensor.detection_noise_px)
    # what an even spread over one step has
    assert np.all(noise.joint_rad == head.sensor.encoder_resolution_rad / np.sqrt(12.0))
    q = head.fixate(POINT)
    of_head = triangulate_gaze(head, q, noise).covariance
    assert np.array_equal(triangulate_gaze(head, q).covariance, of_head)
    steps, plays = np.array([1e-3, 2e-3, 3e-3]), np.array([0.0, 0.01, 0.02])
    tied = HEADS["mis"].replace(actuators={"encoder_resolution_rad": steps})
    expected = np.array([tied.sensor.encoder_resolution_rad] * 3 + [*steps, 0.0]) / np.sqrt(12.0)
    assert Noise.of(tied).joint_rad == pytest.approx(expected)
    # play leaves what is driven on either side of its encoder
    loose = tied.replace(actuators={"backlash_rad": plays})
    expected = np.sqrt(steps**2 / 12.0 + (0.5 * plays) ** 2)
    assert Noise.of(loose).joint_rad[3:6] == pytest.approx(expected)


def test_noise_that_cannot_be_is_refused_by_name() -> None:
    for key, value, expected in (
        ("pixel_px", -0.1, ">= 0"),
        ("pixel_px", np.nan, "finite"),
        ("joint_rad", np.inf, "finite"),
        ("pixel_px", np.ones((2, 3)), r"\(\.\.\., 2, 2\)"),
        ("joint_rad", np.ones(4), r"\(\.\.\., 7\)"),
        ("joint_rad", "large", "large"),
    ):
        refused(rf"Noise\.{key}: expected .*{expected}", Noise, **{key: value})


@pytest.mark.parametrize("name", ["simulated", "icub"])
def test_gaps_of_noisy_views_have_the_predicted_spread(name, rng):
    head, samples = HEADS[name], 4000
    points = np.array([[0.0, -0.1, 1.0], [0.2, 0.05, 0.6]])
    q = np.broadcast_to(head.rest(), (2, 7))
    pixels = head.project(q, points)
    actuators = head.actuation.actuators_of(q)
    errors = rng.normal(0.0, 3e-4, (samples, 1, 7)) * (head.actuation.velocity > 0.0)
    read = head.actuation.joints_of(actuators + errors)
    found = pixels + rng.normal(0.0, 0.4, (samples, *pixels.shape))
    gaps = triangulate_views(head, read, found).gap
    predicted = gap_sigma(head, q, pixels, Noise(pixel_px=0.4, joint_rad=3e-4))
    # a standard deviation of 4,000 samples is known to 1.1 %
    assert np.sqrt((gaps**2).mean(axis=0)) == pytest.approx(predicted, rel=0.05)
    assert not gap_sigma(head, q, pixels, Noise()).any()
    pixels[1, 0] = np.nan
    assert np.isfinite(gap_sigma(head, q, pixels)).tolist() == [True, False]


def ratios_of_equations_27_to_30(head: HeadModel, aside_deg: float) -> NDArray[np.float64]:
    """Variances of the loop, over those if a pixel turned tilt and pan by arctan(1 / f) each."""
    q = head.fixate([np.tan(np.deg2rad(aside_deg)), -0.1, 1.0])
    sigma = np.zeros(7)
    sigma[[4, 3, 6, 5]] = PIXEL_PX / head.cameras.focal.ravel()  # u is pan's and v is tilt's
    article = triangulate_gaze(head, q, Noise(joint_rad=sigma)).covariance
    ours = triangulate_gaze(head, q, Noise(pixel_px=PIXEL_PX)).covariance
    return np.sort(np.linalg.eigvals(np.linalg.solve(ours, article)).real)


def test_equations_27_to_30_hold_straight_ahead() -> None:
    # Both pans are within 3 degrees at 1 m and the tilt of the axes is 4: a few per mille.
    assert ratios_of_equations_27_to_30(HEADS["simulated"], 0.0) == pytest.approx(
        np.ones(3), abs=0.02
    )


def test_equations_27_to_30_underestimate_height_aside_by_the_squared_cosine() -> None:
    """An eye panned by phi and tilted by 1 rad turns its axis by cos(phi) only.

    So to move the image of a target by a pixel vertically the tilt must turn by 1 / (f cos phi),
    and the point rises and falls with that. Equation 28 takes 1 / f, so its variance of height
    is too small by cos^2 phi; in the plane of the two axes, which pan alone moves, the two agree.
    """
    expected = [np.cos(np.deg2rad(25.0)) ** 2, 1.0, 1.0]
    assert ratios_of_equations_27_to_30(HEADS["simulated"], 25.0) == pytest.approx(
        expected, abs=0.02
    )
