"""The rates of finding tags in whole photographs: who finds which, and how a fit came out."""

import json

import cv2
import numpy as np
import pytest

from benchmarks.tag_images.methods import Found, Method
from benchmarks.tag_images.rates import RecordingDetector, cells, main, seen_in
from tests.benchmarks.test_tag_images import photograph_of_a_tag
from vergence.vision import parse_target

PHOTOGRAPH = photograph_of_a_tag(pixels=10)
IMAGE = cv2.GaussianBlur(PHOTOGRAPH.image, (0, 0), 0.7)


def library(*tags: Found) -> list[Method]:
    return [Method("library", "library", lambda image: list(tags))]


def found(number: int, shift_px: float = 0.0) -> Found:
    tag = PHOTOGRAPH.tags[0]
    return Found(number, tag.centre_px + shift_px, tag.corners_px + shift_px)


@pytest.fixture(scope="module")
def ours() -> RecordingDetector:
    return RecordingDetector(parse_target("tag:36h11"))


def test_a_tag_that_both_find_is_one(ours) -> None:
    seen = seen_in("drawn", IMAGE, ours, library(found(5, 1.0)))
    assert [(one.ours, one.library, one.fit) for one in seen] == [(True, (True,), None)]
    assert cells(seen) == [1, 1, 1, 1, 0, 0, 0]


def test_another_number_or_place_is_another_tag(ours) -> None:
    seen = seen_in("drawn", IMAGE, ours, library(found(6), found(5, 60.0)))
    assert [one.tag.id for one in seen] == [6, 5, 5]
    assert cells(seen) == [1, 2, 2, 0, 1, 2, 2]


def test_one_command_makes_the_table_of_rates(tmp_path, capsys) -> None:
    for name in ("near", "far"):
        (tmp_path / name).mkdir()
        cv2.imwrite(str(tmp_path / name / "one.png"), IMAGE)
    cv2.imwrite(str(tmp_path / "empty.png"), np.full((99, 99), 128, np.uint8))
    main([str(tmp_path), "--family", "36h11", "25h9", "--json", str(tmp_path / "alone.json")])
    said = capsys.readouterr().out
    assert "| far | 36h11 | 1 | 1 | 1 | 1 | 1 | 1 | 0 | 0 | 0 |" in said
    assert "| near | 36h11 |" in said
    assert "25h9" not in said
    assert json.loads((tmp_path / "alone.json").read_text()) == []
