"""Calibration of drawn heads from frames as they should be, and as they are."""

from dataclasses import replace

import numpy as np
import pytest

import vergence
from tests.naming import named
from vergence.calibration.head.calibrate import calibrate_head
from vergence.calibration.head.judge import remark_on_few_views, unobservable_directions
from vergence.calibration.head.simulated import simulate_recording
from vergence.errors import ConfigurationError
from vergence.eval.trials.twin_errors import TWIN_SPREADS
from vergence.vision import parse_target

SMALL = {
    "poses": 24, "frames_per_pose": 3, "target": "checkerboard:6x5:40", "distances_m": (0.6, 1.1),
}  # fmt: skip


def drawn(name="physical", seed=0, **options):
    """A nominal head, a true one, and the frames that it saw."""
    head, rng = vergence.load_head(name), np.random.default_rng(seed)
    true = head.perturbed(rng, TWIN_SPREADS)
    return head, true, simulate_recording(head, true, rng, **SMALL | options).frames


@pytest.fixture(scope="module")
def usual():
    """A head, a true one, frames and their calibration."""
    head, true, frames = drawn()
    return head, true, frames, calibrate_head(head, frames)


def depth_error(head, true):
    """Relative errors of depth from the true head's angles and pixels."""
    points = np.array([[0.0, 0.0, 0.5], [0.1, -0.1, 1.0], [-0.3, 0.0, 1.5], [0.0, 0.1, 2.5]])
    q = true.fixate(points)
    fix = vergence.triangulate_views(head, q, true.project(q, points))
    return (fix.point - points)[:, 2] / points[:, 2]


def surprise(found, true):
    """Mean square, in deviations, of the errors along what the frames tell."""
    spreads = found.solution.problem.prior_sigma
    error = found.solution.state.head_parameters - true.parameters(found.nominal_head).values
    error /= spreads
    values, vectors = np.linalg.eigh(found.covariance / np.outer(spreads, spreads))
    told = values < 0.1
    return np.mean(((vectors.T @ error) ** 2 / values)[told])


def assert_right(found, true):
    """The head is within what is claimed, and better than its file by far."""
    # 40 numbers: the mean square deviates by 0.22
    assert surprise(found, true) < 1.9
    heads = found.head, found.nominal_head
    error, before = (np.abs(depth_error(head, true)).max() for head in heads)
    assert error < min(0.01, 0.2 * before)


@pytest.mark.slow
def test_a_head_is_found_with_errors_as_large_as_are_said(usual):
    _, true, frames, found = usual
    assert_right(found, true)
    assert found.kept_views.all()
    assert not found.remarks
    assert found.solution.reduced_chi == pytest.approx(1.0, abs=0.05)
    assert found.rms_px == pytest.approx(0.05 * np.sqrt(2.0), rel=0.1)
    assert np.nanmean(found.held_out_mean_squares) == pytest.approx(1.0, abs=0.1)
    assert len(frames.time_s) == 72


@pytest.mark.slow
@pytest.mark.parametrize("name", ["icub", pytest.param("turrets", marks=pytest.mark.nightly)])
def test_any_head_is_found(name):
    head, true, frames = drawn(name, move_neck=name == "icub", poses=16)
    assert surprise(calibrate_head(head, frames), true) < 1.9


@pytest.mark.slow
def test_true_angles_are_told_better_than_they_were_read(usual):
    head, _, frames, found = usual
    rng = np.random.default_rng(0)  # drawn again, for the true angles of the same frames
    true_q = simulate_recording(head, head.perturbed(rng, TWIN_SPREADS), rng, **SMALL).true_q
    read = frames.joint_positions - true_q
    wrong = found.solution.problem.joint_angles(found.solution.state) - true_q
    # what both pans have in common with the neck is told least
    apart = wrong[:, 4] - wrong[:, 6]
    assert np.std(apart) < 0.5 * np.std(read[:, 4] - read[:, 6])


@pytest.mark.nightly
def test_eyes_and_corners_may_be_missing(usual):
    head, true, frames, _ = usual
    rng = np.random.default_rng(2)
    pixels = frames.pixels.copy()
    pixels[rng.random(pixels.shape[:2]) < 0.3] = np.nan
    pixels[rng.random(pixels.shape[:3]) < 0.2] = np.nan
    assert_right(calibrate_head(head, replace(frames, pixels=pixels)), true)


@pytest.mark.nightly
def test_wrong_detections_are_left_out(usual):
    head, true, frames, _ = usual
    rng = np.random.default_rng(3)
    pixels = frames.pixels.copy()
    wrong = rng.random(pixels.shape[:2]) < 0.2
    for eye, frame in np.argwhere(wrong):
        view = pixels[eye, frame]
        pixels[eye, frame] = (
            view + rng.uniform(20.0, 60.0, 2), view[::-1], view + rng.normal(0.0, 5.0, view.shape),
            rng.uniform(0.0, 480.0, view.shape),
        )[rng.integers(4)]  # fmt: skip
    pixels[rng.random(pixels.shape[:3]) < 0.03] += 15.0
    found = calibrate_head(head, replace(frames, pixels=pixels))
    assert not found.kept_views[wrong].any()
    assert found.kept_views[~wrong].mean() > 0.98
    assert_right(found, true)


@pytest.mark.nightly
def test_angles_that_belong_to_other_frames_count_for_what_they_are_worth(usual):
    head, true, frames, _ = usual
    q = np.roll(frames.joint_positions, 1, axis=0)
    found = calibrate_head(head, replace(frames, joint_positions=q))
    assert surprise(found, true) < 1.9
    assert any("scatter more than their quantisation" in line for line in found.remarks)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("then_m", "said"), [(0.702, "moved before 1.8 s"), (1.2, "stands elsewhere in 18 frames")]
)
def test_a_board_that_was_moved_by_two_millimetres_or_far_is_another_place(then_m, said):
    head, true, near = drawn(poses=12, distances_m=(0.7,))
    far = drawn(poses=12, distances_m=(then_m,))[2]
    later = np.arange(36) >= 18
    moved = {
        "pixels": np.where(later[:, None, None], far.pixels, near.pixels),
        "joint_positions": np.where(later[:, None], far.joint_positions, near.joint_positions),
    }
    found = calibrate_head(head, replace(near, **moved))
    np.testing.assert_array_equal(found.frames.placement, later.astype(int))
    assert said in found.remarks[0]
    assert surprise(found, true) < 1.9


@pytest.mark.nightly
def test_an_eye_whose_images_are_a_frame_late_is_told_and_no_board_that_was_moved(usual):
    head, _, frames, _ = usual
    pixels = frames.pixels.copy()
    pixels[1] = np.roll(pixels[1], 1, axis=0)
    found = calibrate_head(head, replace(frames, pixels=pixels))
    assert "24 of 72 views of the right eye do not go with the others" in found.remarks[0]
    assert "at the same time as the other eye's" in found.remarks[0]
    np.testing.assert_array_equal(found.frames.placement, frames.placement)


@pytest.mark.nightly
def test_a_sigma_that_is_too_small_makes_no_head_too_sure(usual):
    head, true, frames, _ = usual
    found = calibrate_head(head, replace(frames, sigma=0.2 * frames.sigma))
    assert found.solution.reduced_chi == pytest.approx(5.0, rel=0.05)
    assert surprise(found, true) < 1.9


@pytest.mark.slow
def test_what_gives_no_head_is_refused(usual):
    head, _, frames, _ = usual
    q, eyes = frames.joint_positions, slice(None, None, -1)
    elsewhere = frames.select(np.arange(72) % 3 == 0)
    elsewhere.pixels[:, :14] += np.random.default_rng(0).normal(0.0, 8.0, (2, 14, 30, 2))
    for wrong, message in (
        (frames.select(np.arange(3)), "at least 6 poses .*, got 1"),
        (
            replace(frames, pixels=frames.pixels[eyes], sigma=frames.sigma[eyes]),
            "left and right are exchanged",
        ),
        (replace(frames, joint_positions=np.rad2deg(q)), "agree on where the board is"),
        (
            replace(frames, joint_positions=q * [1, 1, 1, 1, -1, 1, 1]),
            "a head that is like its file",
        ),
        (elsewhere, "views that agree with each other, got 48 of which"),
        (
            replace(frames, target=parse_target("checkerboard:6x5:56")),
            "eyes about 92 mm apart, .* is the board of the stated size",
        ),
    ):
        with named(message), pytest.raises(ConfigurationError, match=message):
            calibrate_head(head, wrong)


@pytest.mark.nightly
def test_a_board_of_nearly_another_size_is_pointed_out(usual):
    head, _, frames, _ = usual
    found = calibrate_head(head, replace(frames, target=parse_target("checkerboard:6x5:42.5")))
    assert "mm apart, where the file has 92.0" in found.remarks[0]


@pytest.mark.slow
def test_all_but_redundant_directions_are_told_if_the_neck_moves(usual):
    told = unobservable_directions(usual[3].solution)
    assert [one.what.split(" ")[0] for one in told] == ["10"]
    assert told[0].cure == ""


@pytest.mark.nightly
def test_without_the_neck_the_eyes_place_in_it_is_not_told():
    head, _, frames = drawn(move_neck=False)
    told = unobservable_directions(calibrate_head(head, frames).solution)
    assert [(one.what, one.cure) for one in told[1:]] == [
        ("tilt of both eyes in common", "move the neck"),
        ("roll of both eyes in common", "move the neck"),
        ("shift of both eyes to the side", "move the neck"),
        ("shift of both eyes forward", "move the neck"),
    ]


def test_many_views_that_are_left_out_and_an_eye_that_has_seen_nothing_are_told():
    frames = drawn(poses=12)[2]
    kept = frames.seen.copy()
    assert remark_on_few_views(frames, kept) == []
    kept[1, :4] = False
    (line,) = remark_on_few_views(frames, kept)
    assert line.startswith("4 of 36 views of the right eye")
    frames.pixels[0] = np.nan
    blind = replace(frames)
    assert remark_on_few_views(blind, blind.seen) == [
        "the left eye has never seen the board: it stays as its file has it"
    ]
