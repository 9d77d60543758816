"""Texts of all that a head can look at."""

import pytest

from vergence.errors import ConfigurationError
from vergence.vision.objects.targets import (
    ColourTarget,
    OwnTarget,
    PlaceTarget,
    PointTarget,
    parse_gaze_target,
)
from vergence.vision.targets import AprilTag


def test_texts_are_parsed_and_given_back():
    point = PointTarget(eye=0, pixel=(312.0, 208.5))
    for text, target in {
        "colour:#ff8000": ColourTarget(rgb=(255, 128, 0)),
        "point": PointTarget(),
        "point:left:312:208.5": point,
        "place:0:-100.5:800": PlaceTarget(point_mm=(0.0, -100.5, 800.0)),
        "tag:36h11:5:120": AprilTag(id=5, edge_m=0.12),
    }.items():
        assert parse_gaze_target(text) == target
        assert str(target) == text
    assert parse_gaze_target("COLOR: FF8000") == ColourTarget(rgb=(255, 128, 0))
    assert parse_gaze_target("point", ("left", 312, 208.5)) == point
    own = parse_gaze_target("folder/mine.py:Ball")
    assert isinstance(own, OwnTarget)
    assert str(own) == "folder/mine.py:Ball"


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("colour:orange", "colour: expected #RRGGBB"),
        ("colour:#808890", "expected a colour with a hue"),
        ("face:", "expected face:MODEL.onnx with a file that exists"),
        ("face:gone.onnx", "expected face:MODEL.onnx with a file that exists"),
        ("point:left:3", "expected point, or point:EYE:U:V"),
        ("point:middle:3:4", "expected point, or point:EYE:U:V"),
        ("point:left:nan:4", "expected point, or point:EYE:U:V"),
        ("place:1:2", "expected place:X:Y:Z with three numbers"),
        ("place:1:2:inf", "expected place:X:Y:Z with three numbers"),
        ("mine.py:9", "or mine.py:Class; got 'mine.py:9'"),
        ("no module:Class", "expected module:class or path/to/file.py:class"),
        ("tag:nosuch:1", "nosuch"),
        ("ball", "colour:#RRGGBB"),
    ],
)
def test_other_texts_are_refused_with_what_was_expected(text, expected):
    with pytest.raises(ConfigurationError) as caught:
        parse_gaze_target(text)
    assert expected in str(caught.value)


def test_a_pixel_needs_a_point():
    with pytest.raises(ConfigurationError, match="pixel: expected --target point"):
        parse_gaze_target("colour:#ff8000", ("left", 1.0, 2.0))
