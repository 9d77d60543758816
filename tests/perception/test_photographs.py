"""Photographs and their joint angles: pairs by name, the same angles from every format."""

import json
from pathlib import Path

import numpy as np
import pytest

from tests.eval.refusals import not_refused
from tests.heads import head_of
from tests.naming import refused
from vergence import load_head
from vergence.errors import ConfigurationError, UnreadableFileError
from vergence.perception.photographs import list_photographs, pair_up, read_joint_angles

Q = [0.0, 0.0, 0.0, 0.1, -0.2, 0.12, 0.3]
NAMES = ("left_tilt", "left_pan", "right_tilt", "right_pan")
ANGLES = dict(zip(NAMES, Q[3:], strict=True))
PAIRS = ["a.png", "b.png"]


def write(path, text):
    path.write_text(text if isinstance(text, str) else json.dumps(text), encoding="utf-8")
    return path


TOML = "\n".join(f"{name} = {value}" for name, value in ANGLES.items())
CSV_HEAD = ",".join(NAMES)
CSV_ROW = ",".join(map(str, Q[3:]))


def test_one_row_is_for_all_pairs(tmp_path):
    for name, text in [
        ("q.json", ANGLES), ("q.json", [ANGLES]), ("q.json", {"joints": [ANGLES]}),
        ("q.json", {f"{name}_rad": value for name, value in ANGLES.items()}),
        ("q.json", {f"{name}_deg": np.degrees(value) for name, value in ANGLES.items()}),
        ("q.json", ANGLES | {"neck_yaw": 0.0}), ("q.toml", TOML), ("q.toml", f"[[rows]]\n{TOML}"),
        ("q.csv", f"{CSV_HEAD}\n{CSV_ROW}\n"), ("q.CSV", f"\ufeff{CSV_HEAD}\n{CSV_ROW}\n"),
    ]:  # fmt: skip
        found = read_joint_angles(load_head("physical"), write(tmp_path / name, text), PAIRS)
        for pair in PAIRS:
            np.testing.assert_allclose(found[pair], Q, atol=1e-15)


def test_a_row_for_each_pair_names_its_left_image(tmp_path):
    for name, text in [
        ("q.json", [{"pair": "b.png", **ANGLES}, {"pair": "a", **ANGLES, "left_pan": 0.25}]),
        ("q.json", {"a.png": {**ANGLES, "left_pan": 0.25}, "b.png": ANGLES}),
        ("q.csv", f"pair,{CSV_HEAD}\nb.png,{CSV_ROW}\na,0.1,0.25,0.12,0.3\n"),
        ("q.toml", f'["a.png"]\n{TOML.replace("-0.2", "0.25")}\n["b.png"]\n{TOML}\n'),
    ]:
        found = read_joint_angles(load_head("physical"), write(tmp_path / name, text), PAIRS)
        assert found["b.png"].tolist() == pytest.approx(Q)
        assert found["a.png"][4] == 0.25


def test_actuators_that_tie_joints_may_be_given_in_their_place_and_without_a_file_rest(tmp_path):
    head = head_of("tied")
    values = {"tilt": 0.1, "version": 0.2, "vergence": 0.3, "neck_yaw": 0.4}
    q = read_joint_angles(head, write(tmp_path / "q.json", values), ["a"])["a"]
    np.testing.assert_allclose(q, [0.0, 0.0, 0.4, 0.1, 0.35, 0.1, 0.05], atol=1e-15)
    joints = {"eyes_tilt": 0.1, "left_pan": 0.35, "right_pan": 0.05}
    other = read_joint_angles(head, write(tmp_path / "q.json", joints), ["a"])["a"]
    np.testing.assert_allclose(other[3:], q[3:], atol=1e-15)
    np.testing.assert_array_equal(read_joint_angles(head, None, ["a"])["a"], head.rest())


def test_what_cannot_be_is_refused_in_one_line_that_names_the_file(tmp_path):
    cases = [
        ("q.json", {"left_tilt": 0.1, "left_pan": 0.0}, "got none of right_tilt, right_pan"),
        ("q.json", ANGLES | {"left_pn": 0.1}, "expected joints among neck_yaw.*got 'left_pn'"),
        ("q.json", ANGLES | {"left_pan": 5.0}, r"left_pan: expected -?\d.*left_pan_deg"),
        ("q.json", ANGLES | {"left_pan": "x"}, "left_pan: expected a number, got 'x'"),
        ("q.json", ANGLES | {"left_pan": None}, "left_pan: expected a number, got None"),
        ("q.json", ANGLES | {"left_pan": True}, "left_pan: expected a number, got True"),
        ("q.json", ANGLES | {"left_pan": float("nan")}, "expected a number, got nan"),
        ("q.json", ANGLES | {"left_pan_deg": 1.0}, "expected left_pan once"),
        ("q.json", [ANGLES, ANGLES], "expected the name of the left image as 'pair'"),
        ("q.json", [{"pair": "a", **ANGLES}], "expected a row whose 'pair' is 'b.png', got a"),
        ("q.json", [{"pair": "a", **ANGLES}, {"pair": "a", **ANGLES}], "two of 'a'"),
        ("q.json", [], "expected a row of joint angles"),
        ("q.json", "{", "expected JSON, got what cannot be read"),
        ("q.json", "[" * 100_000, "expected JSON, got what cannot be read"),
        ("q.json", [3], "expected a row of joint angles .*, got something else"),
        ("q.toml", "a = ", "expected TOML, got what cannot be read"),
        ("q.csv", f"{CSV_HEAD}\n0.1,0.2\n", "another number of values than the head"),
        ("q.csv", "", "expected a row of joint angles .*, got none"),
        ("q.txt", "x", "expected JSON, CSV or TOML"),
    ]

    def attempt(file):
        name, text = file
        read_joint_angles(load_head("physical"), write(tmp_path / name, text), PAIRS)

    named = [((name, text), f"(?s)^(?=.*{name}).*{said}") for name, text, said in cases]
    assert not_refused(attempt, named) == []


def test_a_file_that_is_not_there_or_no_text_and_joints_of_a_fixed_pair_are_named(tmp_path):
    file, pair = tmp_path / "q.json", head_of("pair")
    refused(
        r"q\.json: No such file", read_joint_angles, pair, file, PAIRS, error=UnreadableFileError
    )
    file.write_bytes(b"\xff\xfe\x00")
    refused("no text in UTF-8", read_joint_angles, pair, file, PAIRS, error=UnreadableFileError)
    write(file, {"left_pan": 0.1})
    refused(r"none \(a fixed pair\), got 'left_pan'", read_joint_angles, pair, file, PAIRS)


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
