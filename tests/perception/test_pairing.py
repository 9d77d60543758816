"""Pairing of images by names that differ only in the side; numbers compare as numbers."""

from pathlib import Path

import pytest

from tests.naming import refused
from vergence.errors import ConfigurationError
from vergence.perception.photographs import list_photographs, pair_up


def folder_of(path: Path, *names: str) -> Path:
    path.mkdir(exist_ok=True)
    for name in names:
        (path / name).write_bytes(b"")
    return path


def paired(tmp_path: Path, left: str, right: str) -> bool:
    """True if two images of two folders are taken for a pair."""
    folders = [folder_of(tmp_path / side, name) for side, name in (("a", left), ("b", right))]
    found = pair_up(*folders)
    return [(pair.left.name, pair.right.name) for pair in found.pairs] == [(left, right)]


def test_names_that_differ_by_the_side_or_not_at_all_are_a_pair(tmp_path):
    names = [
        ("left12.jpg", "right12.jpg"), ("12_left.png", "12_right.png"),
        ("Left_003.PNG", "Right_003.PNG"), ("imageLeft7.jpg", "imageRight7.jpg"),
        ("leftImage7.jpg", "rightImage7.jpg"), ("l_7.png", "r_7.png"), ("7L.png", "7R.png"),
        ("frame_7_l.tif", "frame_7_r.tif"), ("cam0_000007.png", "cam1_000007.png"),
        ("7-camera0.png", "7-camera1.png"), ("000007.png", "000007.png"),
        ("000007.png", "000007.jpg"), ("a left hand, left.png", "a left hand, right.png"),
    ]  # fmt: skip
    for number, (left, right) in enumerate(names):
        (tmp_path / str(number)).mkdir()
        assert paired(tmp_path / str(number), left, right)


def test_other_names_are_none(tmp_path):
    names = [
        ("left12.jpg", "right13.jpg"), ("left12.jpg", "r12.jpg"), ("cleft12.jpg", "cright12.jpg"),
        ("lamp.png", "ramp.png"), ("cam01.png", "cam11.png"), ("a.png", "b.png"),
    ]  # fmt: skip
    for number, (left, right) in enumerate(names):
        (tmp_path / str(number)).mkdir()
        with pytest.raises(ConfigurationError, match=f"whose names differ by left and.*{left}"):
            paired(tmp_path / str(number), left, right)


def test_numbers_are_in_their_order_and_what_has_no_partner_is_named(tmp_path):
    left = folder_of(tmp_path / "l", "left10.jpg", "left2.jpg", "left1.jpg", "left3.jpg", "a.txt")
    right = folder_of(tmp_path / "r", "right1.jpg", "right2.jpg", "right10.jpg", "right4.jpg")
    pairs, alone = pair_up(left, right)
    assert [pair.name for pair in pairs] == ["left1.jpg", "left2.jpg", "left10.jpg"]
    assert [path.name for path in alone] == ["left3.jpg", "right4.jpg"]


def test_one_folder_may_hold_both_sides_and_two_images_are_a_pair_whatever_their_names(tmp_path):
    both = folder_of(
        tmp_path / "both", "left1.jpg", "right1.jpg", "left2.jpg", "right2.jpg", "x.png"
    )
    pairs, alone = pair_up(both, both)
    names = [(pair.left.name, pair.right.name) for pair in pairs]
    assert names == [("left1.jpg", "right1.jpg"), ("left2.jpg", "right2.jpg")]
    assert [path.name for path in alone] == ["x.png"]
    pairs, alone = pair_up(both / "x.png", both / "left1.jpg")
    assert (pairs[0].name, alone) == ("x.png", [])


def test_what_is_ambiguous_empty_swapped_or_not_there_is_refused(tmp_path):
    one = folder_of(tmp_path, "a.png") / "a.png"
    lefts, rights = (
        folder_of(tmp_path / side, *(f"{side}{number}.png" for number in range(3)))
        for side in ("left", "right")
    )
    both, text, empty = (
        folder_of(tmp_path / name, *files)
        for name, files in (("both", ("a.png", "a.jpg")), ("text", ("a.txt",)), ("empty", ()))
    )
    single = folder_of(tmp_path / "single", "a.png")
    for left, right, said in (
        (single, both, "a.png: expected one image that belongs to it, got"),
        (both, single, "a.png: expected one image that belongs to it, got"),
        (text, single, "expected a folder with images .* right in it, got none among 1 files"),
        (empty, single, "right in it, got an empty one$"),
        (one, tmp_path, "two images or two folders"),
        (rights, lefts, "by their names they are the other way round"),
        (tmp_path / "none", tmp_path, "none: no such file or folder; expected"),
        (one, tmp_path / "none", "none: no such file or folder; expected"),
    ):
        refused(said, pair_up, left, right)
    refused(r"b\.png: no such file or folder", list_photographs, [one, tmp_path / "b.png"])
