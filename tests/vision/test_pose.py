"""Poses of flat targets: exact, with the covariance of their errors, and both where two fit."""

import pickle

import cv2
import numpy as np
import pytest

from tests.models.lenses import LENSES, wide
from tests.naming import refused
from tests.vision.poses import pose
from tests.vision.scenes import CAMERA, in_space, rig, scene
from vergence import load_head
from vergence.vision import (
    AprilGrid,
    AprilTag,
    CharucoBoard,
    Checkerboard,
    Tracker,
    make_detector,
)  # fmt: skip
from vergence.vision.pose import Pose, View, estimate_pose, eye_views

TAG = AprilTag()
BOARD = Checkerboard(columns=9, rows=6, square_m=0.02)


def drawn(
    rng: np.random.Generator,
    depth_m: tuple[float, float] = (0.3, 0.6),
    aside: float = 0.3,
    tilt_rad: tuple[float, float] = (0.35, 0.9),
) -> np.ndarray:
    """A pose with a tilt of random direction, and any roll."""
    z, angle = rng.uniform(*depth_m), rng.uniform(0.0, 2.0 * np.pi)
    tilt = rng.uniform(*tilt_rad) * np.array([np.cos(angle), np.sin(angle), 0.0])
    x, y = rng.uniform(-aside, aside, 2) * z
    return pose(x, y, z, tuple(tilt)) @ pose(0, 0, 0, (0, 0, rng.uniform(-3.0, 3.0)))


def turn(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return cv2.Rodrigues(a[:3, :3] @ b[:3, :3].T)[0].ravel()


def normalised(truth: np.ndarray, found: Pose) -> float:
    """Squared error by the covariance, over 6; of the nearer solution where there are two."""
    each = [one for one in (found, found.other) if one is not None]
    best = min(each, key=lambda one: np.linalg.norm(turn(truth, one.matrix)))
    error = np.concatenate([truth[:3, 3] - best.matrix[:3, 3], turn(truth, best.matrix)])
    return float(error @ np.linalg.solve(best.covariance, error)) / 6.0


@pytest.mark.parametrize("lens", LENSES)
@pytest.mark.parametrize("target", [TAG, BOARD], ids=str)
def test_exact_corners_give_the_exact_pose(lens, target):
    head, rng = wide(lens), np.random.default_rng(1)
    sigma = np.full(target.corners_m.shape, 0.1)
    for _ in range(5):
        T = drawn(rng)
        q = head.fixate(T[:3, 3], warn=False)
        pixels = np.moveaxis(head.project(q, in_space(target, T)), -2, 0)
        both = eye_views(head, q, pixels, (sigma, sigma), 1e-3)
        assert estimate_pose(target.corners_m, both).matrix == pytest.approx(T, abs=1e-8)
        T_C_T = np.linalg.inv(both[0].pose) @ T
        one = estimate_pose(target.corners_m, [View(head.cameras[0], pixels[0], sigma)])
        assert one.matrix == pytest.approx(T_C_T, abs=1e-8)
        assert one.chi_square == pytest.approx(0.0, abs=1e-8)
        assert one.degrees == 2 * len(target.corners_m) - 6
        assert cv2.Rodrigues(one.rotation_vector)[0] == pytest.approx(T_C_T[:3, :3], abs=1e-8)


@pytest.mark.parametrize("target", [TAG, BOARD], ids=str)
def test_with_equal_sigmas_it_is_the_pose_of_opencv(target):
    rng = np.random.default_rng(2)
    board = np.column_stack([target.corners_m, np.zeros(len(target.corners_m))])
    for _ in range(10):
        seen = CAMERA.project(in_space(target, drawn(rng)))
        seen += rng.normal(scale=0.1, size=seen.shape)
        found = estimate_pose(target.corners_m, [View(CAMERA, seen, np.full(seen.shape, 0.1))])
        _, turned, place, _ = cv2.solvePnPGeneric(
            board, seen, CAMERA.matrix, None, flags=cv2.SOLVEPNP_IPPE
        )
        ends = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 200, 1e-14)
        w, t = cv2.solvePnPRefineLM(
            board, seen, CAMERA.matrix, None, turned[0], place[0], criteria=ends
        )
        assert found.matrix[:3, 3] == pytest.approx(t.ravel(), abs=1e-6)
        assert found.matrix[:3, :3] == pytest.approx(cv2.Rodrigues(w)[0], abs=1e-6)


@pytest.mark.parametrize(
    ("lens", "target", "eyes", "correlated", "size"),
    [
        ("fisheye", TAG, 1, False, 1.0), ("rational", TAG, 2, True, 1.0),
        ("brown-conrady", TAG, 2, False, 1.4), ("rational", BOARD, 1, False, 1.0),
        ("fisheye", BOARD, 2, False, 1.0), ("brown-conrady", TAG, 1, True, 1.0),
    ],
    ids=str,
)  # fmt: skip
def test_errors_are_as_large_as_the_covariance_says(lens, target, eyes, correlated, size):
    """The mean normalised squared error of poses in N, with errors of the joints, is 1."""
    head, rng, errors, draws = wide(lens), np.random.default_rng(3), [], 300
    count = 2 * len(target.corners_m)
    poses = [drawn(rng, aside=0.2) for _ in range(draws)]
    angles = head.fixate([T[:3, 3] for T in poses], warn=False)
    off = np.pad(rng.normal(scale=5e-4, size=(draws, 4)), ((0, 0), (3, 0)))
    true_angles = head.actuation.joints_of(head.actuation.actuators_of(angles) + off)
    points = np.array([in_space(target, T, size) for T in poses])
    seen = np.moveaxis(head.project(true_angles[:, None], points), -2, 1)
    for T, q, pixels in zip(poses, angles, seen, strict=True):
        sigma = rng.uniform(0.02, 0.08, pixels.shape)
        error, noise = sigma * rng.normal(size=pixels.shape), sigma
        if correlated:
            mixed = 0.05 * (np.eye(count) + 0.5 * rng.normal(size=(2, count, count)))
            noise = mixed @ mixed.swapaxes(1, 2)
            error = (mixed @ rng.normal(size=(2, count, 1))).reshape(pixels.shape)
        views = eye_views(head, q, pixels + error, noise, 5e-4)[:eyes]
        found = estimate_pose(target.corners_m, views, size_known=size == 1.0)
        errors.append(normalised(T, found))
    # four standard deviations of the mean
    assert np.mean(errors) == pytest.approx(1.0, abs=0.13)


def test_two_eyes_measure_the_size_and_one_scales_with_it():
    head, rng = load_head("simulated"), np.random.default_rng(4)
    T, sigma = drawn(rng), np.full((4, 2), 0.05)
    q = head.fixate(T[:3, 3])
    pixels = np.moveaxis(head.project(q, in_space(TAG, T, 1.5)), -2, 0)
    views = eye_views(head, q, pixels, (sigma, sigma))
    found = estimate_pose(TAG.corners_m, views, size_known=False)
    assert found.size_ratio == pytest.approx(1.5)
    assert found.matrix == pytest.approx(T, abs=1e-6)
    small, large = (
        estimate_pose(size * TAG.corners_m, views[:1], size_known=False) for size in (1.0, 1.5)
    )
    place = views[0].pose[:3, 3]
    assert 1.5 * (small.matrix[:3, 3] - place) == pytest.approx(large.matrix[:3, 3] - place)
    assert small.matrix[:3, :3] == pytest.approx(large.matrix[:3, :3])
    assert 1.5 * small.sigma[:3] == pytest.approx(large.sigma[:3])


def test_corners_that_were_not_found_are_left_out():
    T, sigma = drawn(np.random.default_rng(5)), np.full(BOARD.corners_m.shape, 0.1)
    seen = CAMERA.project(in_space(BOARD, T))
    seen[7:20] = np.nan
    sigma[30] = np.nan
    found = estimate_pose(BOARD.corners_m, [View(CAMERA, seen, sigma)])
    assert found.matrix == pytest.approx(T, abs=1e-8)
    assert found.degrees == 2 * (54 - 14) - 6
    full = np.diag(sigma.ravel() ** 2)
    same = estimate_pose(BOARD.corners_m, [View(CAMERA, seen, full)])
    assert same.covariance == pytest.approx(found.covariance)


@pytest.mark.parametrize(
    "kept", [[], [0, 1, 9], range(9), [0, 1, 2, 3, 4, 9], [0, 10, 20, 30, 3]],
    ids=["none", "three", "a line", "a line and one", "a slanting line and one"],
)  # fmt: skip
def test_corners_that_leave_the_pose_open_give_none(kept):
    seen = CAMERA.project(in_space(BOARD, drawn(np.random.default_rng(6))))
    some = np.full(seen.shape, np.nan)
    some[list(kept)] = seen[list(kept)]
    assert estimate_pose(BOARD.corners_m, [View(CAMERA, some, np.full(seen.shape, 0.1))]) is None
    # one eye that sees enough is enough, and more corners in the other help
    T, sigma = np.eye(4), np.full(seen.shape, 0.1)
    whole, part = View(CAMERA, seen, sigma, T), View(CAMERA, some, sigma, T)
    one, both = (estimate_pose(BOARD.corners_m, views) for views in ([whole], [part, whole]))
    assert both.matrix == pytest.approx(one.matrix, abs=1e-8)
    assert (both.sigma <= 1.000001 * one.sigma).all()


def test_a_wrong_argument_is_named():
    seen, sigma = np.zeros((4, 2)), np.full((4, 2), 0.1)
    for view, named in (
        (View(CAMERA, seen[:3], sigma), "corners_px"),
        (View(CAMERA, seen, sigma[:3]), "noise"),
        (View(CAMERA, seen, -sigma), "positive"),
        (View(CAMERA, TAG.corners_m, np.ones((8, 8))), "positive definite"),
        (View(CAMERA, seen, sigma, np.eye(3)), "pose"),
        (View(CAMERA, seen, sigma, np.eye(4), np.zeros(6)), "pose_errors"),
    ):
        refused(named, estimate_pose, TAG.corners_m, [view])


@pytest.mark.parametrize(
    ("eyes", "depth_m", "factor"),
    [(1, (0.9, 5.0), 1.0), (1, (0.9, 5.0), 2.0), (2, (2.5, 9.0), 1.0)],
)
def test_two_solutions_are_named_where_noise_decides_between_them(eyes, depth_m, factor):
    """Where the best is wrong, and where both fit, and not where one does.

    That holds even if the noise is twice what it is said to be. Whether both fit is known from
    corners without noise: the chi-square of the second minimum is D there, and the chance that
    noise makes it the lower one Phi(-sqrt(D) / 2).
    """
    head, rng, rows = load_head("simulated"), np.random.default_rng(7), []
    for _ in range(300):
        T = drawn(rng, depth_m, 0.2, (0.1, 0.8))
        q = head.fixate(T[:3, 3], warn=False)
        seen = np.moveaxis(head.project(q, in_space(TAG, T)), -2, 0)
        sigma = np.full(seen.shape, np.exp(rng.uniform(np.log(0.03), np.log(0.3))))
        noisy = seen + factor * sigma * rng.normal(size=seen.shape)
        # with a sigma of 100 times as much both are named
        found, exact = (
            estimate_pose(TAG.corners_m, eye_views(head, q, pixels, noise)[:eyes])
            for pixels, noise in ((noisy, sigma), (seen, 100.0 * sigma))
        )
        if exact.other is not None:
            near, far = (np.linalg.norm(turn(found.matrix, e.matrix)) for e in (exact, exact.other))
            D = 1e4 * (exact.other.chi_square - exact.chi_square) / factor**2
            rows.append((found.other is not None, far < near, D < 4.0, D > 60.0))
    named, wrong, both, one = np.array(rows).T
    assert wrong.sum() > 10 < one.sum()
    assert named[wrong].mean() > 0.9
    assert named[both].mean() > 0.95
    assert named[one].mean() < 0.02


@pytest.mark.parametrize(
    ("target", "name"),
    [(TAG, "physical"), (BOARD, "simulated"), (CharucoBoard(), "simulated"),
     (Checkerboard(columns=6, rows=4, square_m=0.03, size_known=False), "physical"),
     (AprilGrid(columns=3, rows=3, tag_m=0.05, spacing=0.3), "physical")],
    ids=str,
)  # fmt: skip
def test_every_detection_has_its_pose(target, name):
    camera, rendering = rig(name)
    T, rng = pose(0.02, 0.01, 0.8, (0.4, 0.3, 0.1)), np.random.default_rng(9)
    image = scene(camera, target, T, rendering, rng).image
    detector = make_detector(target, camera)
    found = detector.detect(image)
    tracked = Tracker(pickle.loads(pickle.dumps(detector))).find(image)
    moved = pickle.loads(pickle.dumps(found))._replace(point_px=np.zeros(2))
    for each in (found, tracked, detector.track(image, found), moved):
        # a symmetric board may be turned by half a turn
        assert each.pose.matrix[:3, 3] == pytest.approx(T[:3, 3], abs=5e-3)
        assert each.pose.matrix[:3, 2] == pytest.approx(T[:3, 2], abs=0.02)
    # without a sigma it is as with 0.1 px
    for sigma in (0.0, np.nan):
        bare = found._replace(
            corners_sigma_px=np.full(found.corners_px.shape, sigma), corners_covariance_px2=None
        )
        assert (bare.pose.sigma > found.pose.sigma).all()
    assert found._replace(corners_px=np.full(found.corners_px.shape, np.nan)).pose is None
    refused("expected a detector made with a camera", lambda: found._replace(camera=None).pose)


def test_corners_of_a_tag_that_share_an_edge_err_together():
    camera, rendering = rig("physical")
    T, rng = pose(0.02, 0.01, 0.8, (0.4, 0.3, 0.1)), np.random.default_rng(9)
    found = make_detector(TAG, camera).detect(scene(camera, TAG, T, rendering, rng).image)
    own = np.sqrt(np.diagonal(found.corners_covariance_px2))
    assert own == pytest.approx(found.corners_sigma_px.ravel(), rel=1e-9)
    joined = np.abs(found.corners_covariance_px2 / np.outer(own, own))
    assert joined == pytest.approx(joined.T, rel=1e-9, abs=1e-12)
    assert 0.2 < (joined - np.eye(8)).max() < 0.9
