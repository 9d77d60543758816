"""Views that do not go together: told, or the recording is refused."""

from dataclasses import replace

import numpy as np
import pytest

import vergence
from vergence.calibration.head.calibrate import calibrate_head
from vergence.calibration.head.judge import remark_on_few_views
from vergence.calibration.head.simulated import simulate_recording
from vergence.errors import ConfigurationError
from vergence.eval.trials.twin_errors import TWIN_SPREADS

HEAD = vergence.load_head("physical")


@pytest.fixture(scope="module")
def frames():
    true = HEAD.perturbed(np.random.default_rng(1), TWIN_SPREADS)
    rng = np.random.default_rng(2)
    return simulate_recording(HEAD, true, rng, poses=12, frames_per_pose=3).frames


@pytest.mark.nightly
def test_an_eye_whose_images_are_a_frame_late_is_no_board_that_was_moved(frames):
    pixels = frames.pixels.copy()
    pixels[1] = np.roll(pixels[1], 1, axis=0)
    with pytest.raises(ConfigurationError, match=r"go together|like its file"):
        calibrate_head(HEAD, replace(frames, pixels=pixels))


@pytest.mark.slow
def test_a_board_that_was_moved_is_another_place(frames):
    twice = simulate_recording(
        HEAD, HEAD, np.random.default_rng(3), poses=12, frames_per_pose=2, distances_m=(0.6, 1.2)
    ).frames
    unsaid = replace(twice, placement=np.zeros_like(twice.placement))
    found = calibrate_head(HEAD, unsaid)
    assert found.frames.placement.tolist() == twice.placement.tolist()
    assert "the board stands elsewhere in 12 frames" in found.remarks[0]


def test_views_that_are_left_out_are_counted_where_they_are_many(frames):
    kept = frames.seen.copy()
    assert remark_on_few_views(frames, kept) == []
    kept[1, :4] = False
    assert [line.partition(" do ")[0] for line in remark_on_few_views(frames, kept)] == [
        "4 of 36 views of the right eye"
    ]


def test_an_eye_that_has_seen_nothing_is_told(frames):
    pixels = frames.pixels.copy()
    pixels[0] = np.nan
    blind = replace(frames, pixels=pixels)
    assert remark_on_few_views(blind, blind.seen) == [
        "the left eye has never seen the board: it stays as its file has it"
    ]
