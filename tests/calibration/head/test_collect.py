"""A head looks about for a board, from postures unlike each other, and loses no frame."""

import shutil
from dataclasses import replace

import numpy as np
import pytest

import vergence
from vergence.calibration.head import calibrate
from vergence.calibration.head.calibrate import (
    DEPTHS_M,
    calibrate_head,
    depth_sigma_m,
    preview_calibration,
)
from vergence.calibration.head.collect import (
    CollectOptions,
    advise_recording,
    collect,
    image_coverage_percent,
)
from vergence.calibration.head.fit import parameter_prior_sigma
from vergence.calibration.head.recording import read_recording
from vergence.calibration.head.simulated import SimulatedLooker, board_ahead, simulate_recording
from vergence.errors import ConfigurationError
from vergence.eval.trials.twin_errors import TWIN_SPREADS
from vergence.recording.log import read_log
from vergence.triangulation import triangulate_views
from vergence.vision import parse_target

pytest.importorskip("mcap")
HEAD = vergence.load_head("physical")
TRUE = HEAD.perturbed(np.random.default_rng(5), TWIN_SPREADS)
BOARD = parse_target("checkerboard:9x6:24")
SMALL = "checkerboard:6x5:40"


class Counted(SimulatedLooker):
    """A looker before a board at some distance, aside by some metres, that counts its looks.

    `blind` gives the eyes that miss the board in a look of that number.
    """

    def __init__(
        self, distance_m=0.7, aside_m=0.0, head=HEAD, true=TRUE, target=BOARD, blind=lambda look: ()
    ):
        pose = board_ahead(head, target, distance_m)
        pose[:3, 3] += (
            aside_m * (head.base_pose(head.rest()) @ head.camera_poses(head.rest()))[0, :3, 0]
        )
        rng = np.random.default_rng(7)
        super().__init__(head, target, pose, rng, true_head=true)
        self.asked, self.blind = [], blind

    def look(self, q):
        self.asked.append(q)
        sight, blind = super().look(q), self.blind(len(self.asked))
        seen = (None if eye in blind else sight.corners_px[eye] for eye in range(2))
        return sight._replace(corners_px=tuple(seen))


@pytest.fixture(scope="module")
def collected(tmp_path_factory):
    """Twelve poses of a head that is not as its model says."""
    folder, evaluated = tmp_path_factory.mktemp("collected"), []
    options = CollectOptions(poses=12, frames=2)
    found = collect(
        Counted(), folder, options, {"plant": "none"},
        on_evaluation=lambda f: evaluated.append(f.poses),
    )  # fmt: skip
    return folder, found, evaluated


@pytest.mark.slow
def test_a_recording_holds_so_many_poses_that_both_eyes_see_and_makes_a_calibration(collected):
    folder, found, evaluated = collected
    frames = read_recording(folder, HEAD).frames
    assert (len(frames.time_s), frames.pose.max()) == (24, 11)
    assert frames.seen.all()
    assert found.looks_without_board == 0
    assert evaluated == [10, 12]
    assert read_log(folder / "0001.mcap").facts["plant"] == "none"
    # boards are spread over the images, all joints move, and dither by some steps of the encoders
    assert (image_coverage_percent(HEAD, frames) >= 80.0).all()
    assert (np.ptp(frames.joint_positions, axis=0) > np.deg2rad(25.0)).all()
    within = [np.ptp(frames.joint_positions[frames.pose == pose], axis=0) for pose in range(12)]
    assert np.max(within) < np.deg2rad(0.7)
    assert (np.mean(within, axis=0) > HEAD.sensor.encoder_resolution_rad).all()
    calibration = calibrate_head(HEAD, frames)
    assert 0.8 < calibration.solution.reduced_chi < 1.2
    assert calibration.kept_corners.all()


@pytest.mark.slow
@pytest.mark.parametrize("name", ["turrets", "icub"])
def test_other_heads_see_their_boards_too(name, tmp_path):
    head = vergence.load_head(name)
    looker = Counted(head=head, true=None)
    found = collect(looker, tmp_path, CollectOptions(poses=4, frames=2), {})
    assert found.frames().seen.all()
    assert all(head.reaches(q) for q in looker.asked)


@pytest.mark.slow
def test_a_board_aside_is_looked_for_and_one_that_is_nowhere_refused(tmp_path):
    looker = Counted(aside_m=0.7)
    assert looker.look(HEAD.rest()).corners_px == (None, None)
    found = collect(looker, tmp_path / "aside", CollectOptions(poses=3, frames=2), {})
    assert found.frames().seen.all()
    with pytest.raises(ConfigurationError, match="found it in no direction of 1"):
        collect(Counted(distance_m=-0.7), tmp_path / "new", CollectOptions(), {})
    assert not (tmp_path / "new").exists()


@pytest.mark.slow
def test_a_later_run_goes_on_with_other_postures(tmp_path):
    for poses in (2, 5):
        collect(Counted(), tmp_path, CollectOptions(poses=poses, frames=2), {})
    assert sorted(path.name for path in tmp_path.iterdir()) == ["0001.mcap", "0002.mcap"]
    frames = read_recording(tmp_path, HEAD).frames
    assert frames.pose.max() == 4
    first = [frames.joint_positions[frames.pose == pose][0] for pose in range(5)]
    apart = [np.abs(a - b).max() for k, a in enumerate(first) for b in first[:k]]
    assert min(apart) > np.deg2rad(3.0)
    looker = Counted()
    collect(looker, tmp_path, CollectOptions(poses=5, frames=2), {})
    assert not looker.asked  # nothing is left to do


@pytest.mark.nightly
def test_a_moved_board_has_another_place_and_is_noticed_unsaid(collected, tmp_path):
    (tmp_path / "0001.mcap").write_bytes((collected[0] / "0001.mcap").read_bytes())
    with pytest.raises(ConfigurationError, match=r"px away: has it been moved \(--moved\)"):
        collect(Counted(0.9), tmp_path, CollectOptions(poses=14, frames=2), {})
    found = collect(Counted(1.6), tmp_path, CollectOptions(poses=3, frames=2, moved=True), {})
    assert found.placement == 1
    frames = read_recording(tmp_path, HEAD).frames
    assert np.bincount(frames.placement).tolist() == [24, 6]
    # the next run is of the same place
    found = collect(Counted(1.6), tmp_path, CollectOptions(poses=4, frames=2), {})
    assert (found.placement, found.poses) == (1, 4)
    frames = read_recording(tmp_path, HEAD).frames
    assert found.frames().placement.tolist() == frames.placement.tolist()


@pytest.mark.slow
def test_a_board_that_is_taken_away_ends_the_recording_which_keeps_its_frames(tmp_path):
    looker = Counted(blind=lambda look: (0, 1) if look > 5 else ())
    with pytest.raises(ConfigurationError, match="found it in none of the last 12 poses"):
        collect(looker, tmp_path, CollectOptions(poses=9, frames=2), {})
    assert len(read_recording(tmp_path, HEAD).frames.time_s) == 4


@pytest.mark.slow
def test_an_eye_that_misses_the_board_now_and_then_costs_its_views_alone(tmp_path):
    looker = Counted(blind=lambda look: (0,) if look % 3 == 0 else ())
    found = collect(looker, tmp_path, CollectOptions(poses=3, frames=6), {})
    frames = read_recording(tmp_path, HEAD).frames
    assert (len(frames.time_s), found.looks_without_board) == (18, 0)
    assert frames.seen[1].all()
    assert frames.seen[0].all(axis=-1).sum() == 12


@pytest.mark.slow
def test_the_predicted_deviation_of_depth_is_that_of_heads_drawn_from_the_covariance():
    rng = np.random.default_rng(4)
    values, spreads = HEAD.parameters().values, parameter_prior_sigma(HEAD)
    count = len(values)
    root = spreads[:, None] * rng.normal(0.0, 0.05 / np.sqrt(count), (count, count))
    predicted = depth_sigma_m(HEAD, values, root @ root.T)
    drawn = HEAD.with_parameters(values + rng.standard_normal((2000, count)) @ root.T)
    eyes = HEAD.camera_poses(HEAD.rest())[:, :3, 3].mean(axis=0)
    for depth_m, sigma in zip(DEPTHS_M, predicted, strict=True):
        point = eyes + [0.0, 0.0, depth_m]
        q = HEAD.fixate(point)
        depths = triangulate_views(drawn, q, HEAD.project(q, point)).point[:, 2]
        # of 2000 draws the deviation is known to 1.6 %; at 2.5 m depth is not quite linear
        middle = 0.5 * np.ptp(np.quantile(depths, [0.1587, 0.8413]))
        assert middle == pytest.approx(sigma, rel=0.15)


@pytest.mark.slow
def test_a_detection_of_something_else_does_not_change_the_prediction(collected):
    frames = collected[1].frames()
    pixels = frames.pixels.copy()
    pixels[0, 3], pixels[1, 20] = pixels[0, 23], 1e14
    wrong = replace(frames, pixels=pixels)
    told, usual = (preview_calibration(HEAD, each) for each in (wrong, frames))
    assert told.depth_percent == pytest.approx(usual.depth_percent, rel=0.2)
    nothing = replace(frames, pixels=np.full(pixels.shape, 50.0))
    assert preview_calibration(HEAD, nothing) is None


def test_advice_says_what_would_tell_more(collected):
    found = collected[1]
    frames = found.frames()
    lines = advise_recording(HEAD, found, frames)
    assert [line.split(":")[0] for line in lines] == [
        "the board stood in one place", "the board was never farther than 0.7 m"
    ]  # fmt: skip
    still = frames.joint_positions.copy()
    still[:, :3] = 0.0
    advice = advise_recording(HEAD, found, replace(frames, joint_positions=still))
    assert advice[0].startswith("the neck has not moved")


def test_what_cannot_be_is_refused_in_one_line(tmp_path):
    for wrong, said in (
        ({"poses": 0}, "poses: expected 1 to 10000, got 0"),
        ({"frames": 101}, "frames: expected 1 to 100, got 101"),
        ({"seed": -1}, "seed: expected a whole number"),
        ({"until": 0.0}, "until: expected a percentage above 0"),
    ):
        with pytest.raises(ConfigurationError, match=said):
            CollectOptions(**wrong)
    with pytest.raises(ConfigurationError, match="expected a size in mm"):
        collect(Counted(target=parse_target("checkerboard:9x6")), tmp_path, CollectOptions(), {})
    (tmp_path / "file").touch()
    with pytest.raises(ConfigurationError, match="expected a folder, got a file"):
        collect(Counted(), tmp_path / "file", CollectOptions(), {})


@pytest.mark.slow
def test_a_kill_loses_one_frame_at_most_and_the_next_run_goes_on(tmp_path):
    left = tmp_path / "left"

    class Killed(Counted):
        def look(self, q):
            if len(self.asked) == 19:  # the disk has what a process that ends here leaves
                shutil.copytree(tmp_path / "all", left)
            return super().look(q)

    collect(Killed(), tmp_path / "all", CollectOptions(poses=6, frames=4, seed=3), {})
    found = read_recording(left, HEAD)
    # the first look is the search's
    assert 17 <= len(found.frames.time_s) <= 18
    assert found.remarks == ("1 of 1 logs are cut off: read up to there",)
    poses = int(found.frames.pose.max()) + 1
    collect(Counted(), left, CollectOptions(poses=poses + 1, frames=2), {})
    after = read_recording(left, HEAD).frames
    assert after.pose.max() == poses


@pytest.mark.slow
def test_poses_added_to_a_fit_tell_what_a_fit_to_all_frames_tells(monkeypatch):
    monkeypatch.setattr(calibrate, "_ALWAYS_FITTED_POSES", 10)
    rng = np.random.default_rng(3)
    frames = simulate_recording(HEAD, TRUE, rng, poses=16, frames_per_pose=3, target=SMALL).frames
    first = preview_calibration(HEAD, frames.select(frames.pose < 11))
    added, fitted = (preview_calibration(HEAD, frames, known) for known in (first, None))
    assert added.later is not None
    assert fitted.later is None
    assert (fitted.depth_percent < first.depth_percent).all()
    # a step from the head that 11 poses tell, whose depth is a quarter less sure
    np.testing.assert_allclose(added.depth_percent, fitted.depth_percent, rtol=0.03)
    sigma = parameter_prior_sigma(HEAD)
    away = (added.values - fitted.values)[sigma > 0.0] / sigma[sigma > 0.0]
    assert np.abs(away).max() < 0.02
    # a board that was moved since takes a fit to all frames, which leaves it out
    pixels = frames.pixels.copy()
    pixels[:, frames.pose >= 11] += 5.0
    assert preview_calibration(HEAD, replace(frames, pixels=pixels), first).later is None
