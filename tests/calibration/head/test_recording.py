"""A recording is read as it was written, whatever order it has, or refused in one line."""

import csv
import json
import shutil
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

import vergence
from tests.calibration.head.recordings import log_frames, log_view
from tests.naming import named
from vergence.calibration.head.recording import read_recording, sort_and_clean_frames
from vergence.calibration.head.simulated import SimulatedLooker, board_ahead, simulate_recording
from vergence.errors import ConfigurationError, UnreadableFileError
from vergence.recording.schema import LoggedDetection
from vergence.recording.writer import LogWriter
from vergence.vision import parse_target

pytest.importorskip("mcap")
HEAD = vergence.load_head("physical")
BOARD = parse_target("checkerboard:9x6:24")


@pytest.fixture(scope="module")
def frames():
    rng = np.random.default_rng(1)
    return simulate_recording(HEAD, HEAD, rng, poses=8, frames_per_pose=3).frames


def test_a_log_gives_the_frames_that_were_written_to_the_bit_in_any_order(tmp_path, frames):
    found = read_recording(log_frames(tmp_path / "a.mcap", HEAD, frames), HEAD)
    assert (found.files, found.remarks, found.read_errors) == (("a.mcap",), (), ())
    order = np.random.default_rng(0).permutation([*range(24), 3, 4, 5])
    shuffled = read_recording(log_frames(tmp_path / "b.mcap", HEAD, frames, order=order), HEAD)
    assert shuffled.sha256 == found.sha256
    for read in (found.frames, shuffled.frames):
        for name in ("joint_positions", "pixels", "sigma", "placement"):
            np.testing.assert_array_equal(getattr(read, name), getattr(frames, name))
        np.testing.assert_allclose(np.diff(read.time_s), np.diff(frames.time_s), atol=1e-9)


def test_frames_of_a_head_at_rest_count_as_one(frames):
    repeated = frames.select(np.repeat(np.arange(24), 3))
    repeated.pixels[:] += repeated.sigma * np.random.default_rng(0).standard_normal(
        repeated.pixels.shape
    )
    assert len(sort_and_clean_frames(repeated).time_s) == 24
    repeated.joint_positions[:, 3] += 1e-3 * np.arange(72)  # readings that differ tell more
    assert len(sort_and_clean_frames(repeated).time_s) == 72


def test_the_digest_tells_other_corners_and_other_angles(tmp_path, frames):
    digests = set()
    for number, part in enumerate(("pixels", "joint_positions", "")):
        other = frames
        if part:
            values = getattr(frames, part).copy()
            values.flat[0] += 1e-4
            other = replace(frames, **{part: values})
        path = log_frames(tmp_path / f"{number}.mcap", HEAD, other)
        digests.add(read_recording(path, HEAD).sha256)
    assert len(digests) == 3


def test_logs_of_a_folder_follow_each_other_and_their_places_have_no_gaps(tmp_path, frames):
    # clocks begin anew with each log, and `10` comes after `2`
    for name, placement in (("10", 7), ("2", 3)):
        log_frames(tmp_path / "same" / f"{name}.mcap", HEAD, frames, placement=str(placement))
    found = read_recording(tmp_path / "same", HEAD)
    assert found.files == ("2.mcap", "10.mcap")
    assert (np.diff(found.frames.time_s) > 0.0).all()
    assert found.frames.placement.tolist() == [0] * 24
    for name, first, placement in (("1", 0, 2), ("2", 12, 5)):
        some = frames.select(np.arange(first, first + 12))
        log_frames(tmp_path / "other" / f"{name}.mcap", HEAD, some, placement=str(placement))
    found = read_recording(tmp_path / "other", HEAD).frames
    assert found.placement.tolist() == [0] * 12 + [1] * 12


def test_an_eye_without_the_board_is_nan_and_no_frame_lacks_it(tmp_path, frames):
    pixels = frames.pixels.copy()
    pixels[1, 0] = pixels[:, 1] = np.nan
    half = replace(frames, pixels=pixels)
    found = read_recording(log_frames(tmp_path / "a.mcap", HEAD, half), HEAD).frames
    assert len(found.time_s) == 23
    assert found.seen[0, 0].all()
    assert not found.seen[1, 0].any()


def test_exposures_of_both_eyes_are_one_frame_within_half_the_time_between_frames(tmp_path, frames):
    half = 0.5 * HEAD.timing.frame_s
    near = log_frames(tmp_path / "a.mcap", HEAD, frames, skew_s=0.9 * half)
    far = log_frames(tmp_path / "b.mcap", HEAD, frames, skew_s=1.1 * half)
    assert read_recording(near, HEAD).frames.seen.all()
    apart = read_recording(far, HEAD).frames
    assert len(apart.time_s) == 48
    assert (apart.seen.any(axis=-1).sum(axis=0) == 1).all()


def test_images_of_a_robot_in_motion_are_left_out(tmp_path, frames):
    path = tmp_path / "deploy.mcap"
    corners, nan = frames.pixels[0, 0], np.full(2, np.nan)
    step = HEAD.sensor.encoder_resolution_rad
    with LogWriter(path, head=HEAD, facts={"target": str(frames.target)}) as log:
        for i in range(100):
            # at rest for half a second but for a reading on the edge of a step, then a motion
            q = np.full(7, step * (i % 2) if i < 50 else 0.1 * (i - 50) / 100)
            log.joints(i / 100, q, np.zeros(7))
            if i % 10 == 0:
                log.detection(
                    LoggedDetection("left", i / 100, i / 100, q, nan, nan, corners + i,
                                    np.full(corners.shape, 0.1))
                )  # fmt: skip
    found = read_recording(path, HEAD)
    assert found.frames.pixels[0, :, 0, 0] - corners[0, 0] == pytest.approx([0, 10, 20, 30, 40])
    assert found.remarks == ("5 images left out, as joints were moving",)


def test_a_log_that_is_cut_off_or_of_another_geometry_is_read_with_a_remark(tmp_path, frames):
    path = log_frames(tmp_path / "a.mcap", HEAD, frames)
    path.write_bytes(path.read_bytes()[:-2000])
    (tmp_path / "b.mcap").write_bytes(b"")
    found = read_recording(tmp_path, HEAD)
    assert 0 < len(found.frames.time_s) <= 24
    assert found.remarks == ("1 of 1 logs are cut off: read up to there",)
    assert "it is empty" in found.read_errors[0]
    with pytest.raises(UnreadableFileError, match="it is empty"):
        read_recording(tmp_path / "b.mcap", HEAD)
    other = HEAD.replace(cameras={"focal": HEAD.cameras.focal + 1.0})
    found = read_recording(log_frames(tmp_path / "c.mcap", other, frames), HEAD)
    assert found.remarks == ("1 of 1 logs: the head had other numbers than physical",)


@pytest.mark.slow
def test_logs_that_do_not_fit_are_refused_in_one_line(tmp_path, frames):
    none = frames.select(np.zeros(24, dtype=bool))
    cases = [
        ({"target": ""}, None, "expected the board among the log's facts, or as --target"),
        ({}, parse_target("checkerboard:9x6:25"), "expected checkerboard:9x6:25, got a log of"),
        ({"target": "checkerboard:8x6:24"}, None, "expected the 48 corners of .*, got 54"),
        ({"target": "checkerboard:9x6"}, None, "expected a size in mm"),
        ({"target": "tag:36h11"}, None, "expected one tag, with its number"),
        ({"placement": "-1"}, None, "placement: expected a whole number below 1000, got '-1'"),
    ]
    for number, (facts, target, said) in enumerate(cases):
        path = log_frames(tmp_path / f"{number}.mcap", HEAD, frames, **facts)
        with pytest.raises(ConfigurationError, match=said):
            read_recording(path, HEAD, target)
    with pytest.raises(ConfigurationError, match="got one of physical with neck_yaw"):
        read_recording(tmp_path / "0.mcap", vergence.load_head("turrets"), BOARD)
    with pytest.raises(ConfigurationError, match=r"expected frames that show .*, got none in 0"):
        read_recording(log_frames(tmp_path / "none.mcap", HEAD, none), HEAD)
    with pytest.raises(ConfigurationError, match="no such file or folder"):
        read_recording(tmp_path / "nowhere", HEAD)
    (tmp_path / "empty").mkdir()
    with pytest.raises(ConfigurationError, match="expected logs of a robot"):
        read_recording(tmp_path / "empty", HEAD)
    path = tmp_path / "seconds.mcap"
    with LogWriter(path, head=HEAD, facts={"target": str(frames.target), "at_rest": "True"}) as log:
        for frame in range(3):
            log_view(log, frames, 0, frame, 1.0)
    with pytest.raises(ConfigurationError, match="times that tell images apart, got two of the"):
        read_recording(path, HEAD)


SMALL = HEAD.replace(
    cameras={name: 0.5 * getattr(HEAD.cameras, name) for name in ("focal", "principal")}
    | {"size": HEAD.cameras.size // 2}
)
"""The head with images of 320 x 240 px, which are drawn and searched in less time."""


def photograph(looker, folder, name, q):
    """Photograph the board with both eyes at joint angles; what was seen and read."""
    sight = looker.look(q)
    for eye, image in zip(("left", "right"), looker.images, strict=True):
        (folder / eye).mkdir(exist_ok=True)
        cv2.imwrite(str(folder / eye / name), image)
    return sight


@pytest.fixture(scope="module")
def photographs(tmp_path_factory) -> Path:
    """A folder of drawn photographs with a table of angles, in degrees, and their angles."""
    folder = tmp_path_factory.mktemp("photographs")
    rng = np.random.default_rng(2)
    looker = SimulatedLooker(SMALL, BOARD, board_ahead(SMALL, BOARD, 0.7), rng, drawn=True)
    rows = []
    for number in range(3):
        q = SMALL.rest() + np.deg2rad(rng.uniform(-3.0, 3.0, 7))
        sight = photograph(looker, folder, f"{number}.png", q)
        rows.append([f"{number}.png", *np.rad2deg(sight.positions), 0, 3 - number])
    names = [f"{name}_deg" for name in SMALL.joints]
    with (folder / "joints.csv").open("w", newline="") as file:
        csv.writer(file).writerows([["pair", *names, "placement", "time_s"], *rows])
    return folder


@pytest.mark.nightly
def test_photographs_and_their_table_are_frames_in_the_order_of_their_times(photographs):
    fractions = []
    found = read_recording(photographs, SMALL, BOARD, fractions.append)
    assert found.frames.seen.all()
    assert found.frames.time_s.tolist() == [1.0, 2.0, 3.0]
    # the last photograph has the first time
    with (photographs / "joints.csv").open() as file:
        yaws = [float(row["neck_yaw_deg"]) for row in csv.DictReader(file)]
    np.testing.assert_allclose(np.rad2deg(found.frames.joint_positions[::-1, 0]), yaws)
    assert fractions[-1] == 1.0
    assert found.files[-1] == "joints.csv"
    assert found.files[:2] == ("left/0.png", "right/0.png")


@pytest.mark.slow
def test_a_photograph_of_nothing_and_one_without_a_partner_are_told(photographs, tmp_path):
    shutil.copytree(photographs, tmp_path, dirs_exist_ok=True)
    cv2.imwrite(str(tmp_path / "right" / "0.png"), np.full((240, 320), 90, np.uint8))
    (tmp_path / "left" / "1.png").write_bytes(b"no image")
    (tmp_path / "right" / "2.png").unlink()
    found = read_recording(tmp_path, SMALL, BOARD)
    assert found.frames.seen.all(axis=-1).tolist() == [[False, True], [True, False]]
    assert found.remarks == ("1 images without a partner left out: 2.png",)
    assert len(found.read_errors) == 1
    assert "1.png" in found.read_errors[0]


@pytest.mark.slow
def test_a_tag_is_a_board_of_photographs_too(tmp_path):
    tag = parse_target("tag:36h11:0:120")
    pose, rng = board_ahead(SMALL, tag, 0.7), np.random.default_rng(2)
    looker = SimulatedLooker(SMALL, tag, pose, rng, drawn=True)
    sight = photograph(looker, tmp_path, "1.png", SMALL.rest())
    angles = dict.fromkeys(SMALL.joints, 0.0)
    (tmp_path / "joints.json").write_text(json.dumps([{"pair": "1", **angles}]))
    found = read_recording(tmp_path, SMALL, tag).frames
    # without the lens, corners are off by hundredths of a pixel
    np.testing.assert_allclose(found.pixels[0, 0], sight.corners_px[0], atol=0.1)


@pytest.mark.slow
def test_tables_that_do_not_fit_are_refused_in_one_line(photographs, tmp_path):
    cases = [
        (lambda lines: lines[:-1], "expected a row whose 'pair' is '2.png'"),
        (lambda lines: [lines[0].replace("neck_yaw", "neck_jaw"), *lines[1:]], "neck_jaw_deg"),
        (lambda lines: [*lines[:-1], lines[-1].replace(",0,1", ",x,1")], "placement: expected a n"),
        (lambda lines: [*lines[:-1], lines[-1].replace(",0,1", ",1.5,1")], "a whole number below"),
        (lambda lines: [*lines[:-1], lines[-1].replace(",0,1", ",0,")], "time_s: expected a numb"),
    ]
    for eye in ("left", "right"):
        (tmp_path / eye).symlink_to(photographs / eye)
    table, lines = tmp_path / "joints.csv", (photographs / "joints.csv").read_text().splitlines()
    for edit, said in cases:
        table.write_text("\n".join(edit(lines)))
        with named(said), pytest.raises(ConfigurationError, match=said):
            read_recording(tmp_path, SMALL, BOARD)
    # without times and places, photographs count in the order of their names
    table.write_text("\n".join(line.rsplit(",", 2)[0] for line in lines))
    found = read_recording(tmp_path, SMALL, BOARD).frames
    assert (found.time_s.tolist(), found.placement.tolist()) == ([0.0, 1.0, 2.0], [0, 0, 0])
    with pytest.raises(ConfigurationError, match="expected the board of these photographs"):
        read_recording(photographs, SMALL)
    with pytest.raises(ConfigurationError, match="expected images of 1280 x 960 px, as the head"):
        read_recording(photographs, SMALL.replace(cameras={"size": (1280, 960)}), BOARD)
    table.unlink()
    with pytest.raises(ConfigurationError, match=r"expected one of joints\.csv, .* got none"):
        read_recording(tmp_path, SMALL, BOARD)
