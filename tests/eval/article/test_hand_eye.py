"""Head-eye transforms found from a head's own movements, by each eye and by both at once."""

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import vergence
from tests.naming import named
from vergence.calibration.head.simulated import simulate_recording
from vergence.errors import ConfigurationError
from vergence.eval.article.hand_eye import refine_by_reprojection, solve_both_eyes, solve_each_eye
from vergence.models.geometry import inverse_pose

FINDS = (solve_each_eye, solve_both_eyes)
SIGMA_PX = 0.05
EXACT = 1e-9


def seen_by(name, *, distances_m=(0.7,), poses=20, **options):
    """A head, its believed model, whose cameras sit elsewhere, and what it saw, all exactly."""
    true = vergence.load_head(name)
    head_eye = np.array(true.head_eye)
    turns = Rotation.from_rotvec(np.deg2rad([[12.0, -12.0, 10.0], [-14.0, 8.0, 12.0]]))
    head_eye[:, :3, :3] = turns.as_matrix() @ head_eye[:, :3, :3]
    head_eye[:, :3, 3] += [[0.02, -0.015, 0.015], [-0.02, 0.02, 0.01]]
    seen = simulate_recording(
        true, true, np.random.default_rng(1), poses=poses, frames_per_pose=2, noise_px=0.0,
        distances_m=distances_m, **options,
    )  # fmt: skip
    sigma = np.full_like(seen.frames.sigma, SIGMA_PX)
    frames = dataclasses.replace(seen.frames, joint_positions=seen.true_q, sigma=sigma)
    return true, true.replace(head_eye=head_eye), frames


def assert_found(found, true, tolerance=EXACT):
    np.testing.assert_allclose(found.head_eye, true.head_eye, atol=tolerance)


@pytest.mark.parametrize("name", ["physical", "turrets", "icub"])
def test_eyes_are_found_exactly_however_far_the_cameras_are_from_the_model(name):
    true, head, frames = seen_by(name)
    for find in FINDS[: 1 if name == "icub" else 2]:  # its eyes have one tilt, see below
        with named(find):
            found = find(head, frames)
            assert_found(found, true)
            assert found.rms_px < EXACT
            assert found.kept_views.all()


def test_eyes_with_one_common_tilt_are_not_found_at_once():
    _true, head, frames = seen_by("icub")
    with pytest.raises(ConfigurationError, match="eyes against each other to turn about two axes"):
        solve_both_eyes(head, frames)


def test_a_board_may_move():
    true, head, frames = seen_by("physical", distances_m=(0.5, 0.9))
    for find in FINDS:
        with named(find):
            assert_found(find(head, frames), true)


def test_both_eyes_at_once_need_neither_the_neck_nor_the_boards_place():
    true, head, frames = seen_by("physical")
    wrong = frames.joint_positions.copy()
    wrong[:, :3] += np.random.default_rng(0).uniform(-0.3, 0.3, (len(wrong), 3))
    found = solve_both_eyes(head, dataclasses.replace(frames, joint_positions=wrong))
    assert_found(found, true)


@pytest.mark.parametrize("find", FINDS)
def test_views_that_show_something_else_do_not_count(find):
    true, head, frames = seen_by("physical", poses=30)
    rng = np.random.default_rng(2)
    pixels, bad = frames.pixels.copy(), np.zeros(frames.pixels.shape[:2], dtype=bool)
    for eye in range(2):
        bad[eye, rng.choice(60, 12, replace=False)] = True
        # half of the bad views are of another moment, half have the board beside its place
        moved = np.flatnonzero(bad[eye])
        pixels[eye, moved[:6]] = frames.pixels[eye, (moved[:6] + 17) % 60]
        pixels[eye, moved[6:]] += rng.uniform(8.0, 20.0, (6, 1, 2))
    found = find(head, dataclasses.replace(frames, pixels=pixels))
    assert_found(found, true)
    assert not found.kept_views[bad].any()


def test_views_without_the_board_do_not_count():
    true, head, frames = seen_by("physical")
    pixels = frames.pixels.copy()
    pixels[0, :10] = pixels[1, 5:15] = np.nan
    for find in FINDS:
        with named(find):
            found = find(head, dataclasses.replace(frames, pixels=pixels))
            assert_found(found, true)
            assert not found.kept_views[0, :10].any()


@pytest.mark.slow
def test_noise_of_corners_and_encoders_leaves_a_tenth_of_a_degree():
    true = vergence.load_head("physical")
    seen = simulate_recording(true, true, np.random.default_rng(3), poses=40, frames_per_pose=4)
    for find in FINDS:
        off = inverse_pose(find(true, seen.frames).head_eye) @ true.head_eye
        assert np.rad2deg(Rotation.from_matrix(off[:, :3, :3]).magnitude()).max() < 0.5


@pytest.mark.slow
def test_reprojection_finds_both_exactly_and_leaves_the_rest_of_the_head():
    true, head, frames = seen_by("physical")
    noisy = solve_each_eye(head, frames)
    nudge = np.eye(4)
    nudge[:3, :3] = Rotation.from_rotvec([0.01, -0.02, 0.01]).as_matrix()
    nudge[:3, 3] = [0.002, -0.001, 0.002]
    start = noisy._replace(head_eye=noisy.head_eye @ nudge)
    found = refine_by_reprojection(head, frames, start)
    assert_found(found, true, 1e-7)
    assert found.rms_px < 1e-4


@pytest.mark.slow
def test_what_tells_no_pose_is_refused():
    _, still, about_one_axis = seen_by("simulated", move_neck=False, off_axis=0.0, dither_rad=0.0)
    _, head, frames = seen_by("physical")
    positions = np.random.default_rng(4).uniform(-0.8, 0.8, frames.joint_positions.shape)
    of_others = dataclasses.replace(frames, joint_positions=positions)
    for wrong, seen, said in (
        (still, about_one_axis, "turn about two axes"),
        (head, frames.select(np.array([0, 4])), r"expected at least 3 poses of the .*, got 2"),
        (head, of_others, "joint angles that belong to the images"),
    ):
        for find in FINDS:
            with named(find, said), pytest.raises(ConfigurationError, match=said):
                find(wrong, seen)


MOTIONS = {
    "common tilt": (lambda t: [0, 0, 0, t, 0.1, -t, -0.1], 6),
    "version": (lambda t: [0, 0, 0, 0.0, t, 0.0, t], 9),
    "vergence": (lambda t: [0, 0, 0, 0.0, t, 0.0, -t], 11),
    "fixation": (lambda t: [0, 0, 0, np.sin(5 * t), t, -np.sin(5 * t), t * t], 11),
    "all": (lambda t: [0, 0, 0, np.sin(5 * t), t, np.sin(3 * t), np.cos(7 * t)], 12),
}


@pytest.mark.nightly
def test_the_numbers_that_both_eyes_at_once_can_see_are_those_of_the_docs():
    head = vergence.load_head("physical")
    names = head.parameters().names
    places = [place for place, name in enumerate(names) if ".head_eye." in name]
    for motion, (move, rank) in MOTIONS.items():
        with named(motion):
            q = np.array([move(t) for t in np.linspace(-0.5, 0.5, 12)])
            seen = relation_by_numbers(head, q)[:, places]
            assert np.linalg.matrix_rank(seen, tol=1e-4) == rank


def relation_by_numbers(head, q):
    """(12 n, p) derivatives of T_Cl_Cr at joint angles by a head's numbers."""
    values, step = head.parameters().values, 1e-5

    def relation(change):
        cameras = head.with_parameters(values + change).camera_poses(q)
        return (inverse_pose(cameras[:, 0]) @ cameras[:, 1])[:, :3].ravel()

    return np.column_stack(
        [(relation(step * row) - relation(-step * row)) / (2 * step) for row in np.eye(len(values))]
    )
