"""Pairing of images by names that differ only in the side; numbers compare as numbers."""

from pathlib import Path

import pytest

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
    for number, (left, right) in enumerate(
        (
            ("left12.jpg", "right13.jpg"),
            ("left12.jpg", "r12.jpg"),
            ("cleft12.jpg", "cright12.jpg"),
            ("lamp.png", "ramp.png"),
            ("cam01.png", "cam11.png"),
            ("a.png", "b.png"),
        )
    ):
        (tmp_path / str(number)).mkdir()
        with pytest.raises(ConfigurationError, match=f"whose names differ by left and.*{left}"):
            paired(tmp_path / str(number), left, right)


def test_numbers_are_in_their_order_and_what_has_no_partner_is_named(tmp_path):
    left = folder_of(tmp_path / "l", "left10.jpg", "left2.jpg", "left1.jpg", "left3.jpg", "a.txt")
    right = folder_of(tmp_path / "r", "right1.jpg", "right2.jpg", "right10.jpg", "right4.jpg")
    pairs, alone, single = pair_up(left, right)
    assert [pair.name for pair in pairs] == ["left1.jpg", "left2.jpg", "left10.jpg"]
    assert [path.name for path in alone] == ["left3.jpg", "right4.jpg"]
    assert not single


def test_one_folder_may_hold_both_sides(tmp_path):
    both = folder_of(
        tmp_path / "both", "left1.jpg", "right1.jpg", "left2.jpg", "right2.jpg", "x.png"
    )
    pairs, alone, _ = pair_up(both, both)
    assert [(p.left.name, p.right.name) for p in pairs] == [
        ("left1.jpg", "right1.jpg"),
        ("left2.jpg", "right2.jpg"),
    ]
    assert [path.name for path in alone] == ["x.png"]


def test_two_images_are_a_pair_whatever_they_are_called(tmp_path):
    folder_of(tmp_path, "one.png", "other.png")
    pairs, alone, single = pair_up(tmp_path / "one.png", tmp_path / "other.png")
    assert (pairs[0].name, alone, single) == ("one.png", [], True)


def test_what_is_ambiguous_or_empty_is_refused(tmp_path):
    cases = [
        (("a.png",), ("a.png", "a.jpg"), "a.png: expected one image that belongs to it, got"),
        (("a.png", "a.jpg"), ("a.png",), "a.png: expected one image that belongs to it, got"),
        ((), ("a.png",), "expected a folder with images"),
        (("a.txt",), ("a.png",), "expected a folder with images"),
    ]
    for number, (left, right, said) in enumerate(cases):
        folders = [
            folder_of(tmp_path / f"{number}{side}", *names)
            for side, names in (("a", left), ("b", right))
        ]
        with pytest.raises(ConfigurationError, match=said):
            pair_up(*folders)


def test_an_image_and_a_folder_are_refused(tmp_path):
    folder_of(tmp_path, "a.png")
    with pytest.raises(ConfigurationError, match="two images or two folders"):
        pair_up(tmp_path / "a.png", tmp_path)


def test_folders_the_other_way_round_are_told(tmp_path):
    for side in ("left", "right"):
        (tmp_path / side).mkdir()
        for number in range(3):
            (tmp_path / side / f"{side}{number}.png").touch()
    with pytest.raises(ConfigurationError, match="by their names they are the other way round"):
        pair_up(tmp_path / "right", tmp_path / "left")


def test_what_is_not_there_is_said_with_what_was_expected(tmp_path):
    (tmp_path / "empty").mkdir()
    there = tmp_path / "a.png"
    there.touch()
    for left, right in ((tmp_path / "none", tmp_path), (there, tmp_path / "none")):
        with pytest.raises(ConfigurationError, match=r"none: no such file or folder; expected"):
            pair_up(left, right)
    with pytest.raises(ConfigurationError, match=r"right in it, got an empty one$"):
        pair_up(tmp_path / "empty", tmp_path)
    with pytest.raises(ConfigurationError, match=r"b\.png: no such file or folder"):
        list_photographs([there, tmp_path / "b.png"])
