"""The table of detectors of tags: points go where it says, and what is found is counted right."""

import cv2
import numpy as np
import pandas as pd
import pytest

from benchmarks import false_positives
from benchmarks.tag_images.__main__ import main
from benchmarks.tag_images.catalogue import VARIATIONS
from benchmarks.tag_images.methods import Found, make_methods
from benchmarks.tag_images.photographs import KnownTag, Photograph, crossing, tags_from
from benchmarks.tag_images.scores import score
from benchmarks.tag_images.variations import vary
from tests.naming import named
from vergence.errors import VergenceError

SQUARE = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])


def known_tag(number: int, centre_px: tuple[float, float], edge_px: float) -> KnownTag:
    corners = np.asarray(centre_px) + 0.5 * edge_px * SQUARE
    return KnownTag(number, corners, crossing(corners))


def photograph_of_a_tag(number: int = 5, pixels: int = 10, corner_px: int = 150) -> Photograph:
    """A drawn tag in a plain picture; its edges are edges of pixels."""
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    edge = 8 * pixels
    image = np.full((2 * corner_px + edge,) * 2, 220, dtype=np.uint8)
    inside = slice(corner_px, corner_px + edge)
    image[inside, inside] = 30 + 0.7 * cv2.aruco.generateImageMarker(dictionary, number, edge)
    middle = corner_px + 0.5 * edge - 0.5
    return Photograph("drawn", image, (known_tag(number, (middle, middle), edge),))


def centroid(image: np.ndarray) -> np.ndarray:
    """Centroid of the pixels darker than the background, whose grey value is the median."""
    weight = np.clip(np.median(image) - image.astype(float) - 6.0, 0.0, None)
    rows, columns = np.indices(image.shape)
    return np.array([np.sum(weight * columns), np.sum(weight * rows)]) / weight.sum()


@pytest.mark.slow
def test_a_dot_goes_where_the_mapping_says() -> None:
    dot = np.array([301.3, 296.6])
    rows, columns = np.indices((600, 600))
    distance = np.hypot(columns - dot[0], rows - dot[1])
    image = (230.0 - 200.0 * np.exp(-0.5 * (distance / 4.0) ** 2)).astype(np.uint8)
    tag = known_tag(0, (300.0, 300.0), 120.0)
    # what light, noise and JPEG do to a dot moves its centroid
    moved = ("ramp", "shadow", "noise", "JPEG", "dimmed", "motion 12")
    for variation in VARIATIONS:
        if any(word in variation.name for word in moved):
            continue
        with named(variation.name):
            for seed in range(3):
                varied = vary(image, tag, variation, np.random.default_rng(seed))
                # a wrong pixel convention is off by half a pixel; perspective and whole grey values
                # move the centroid of so small a dot by less than a tenth
                assert centroid(varied.image) == pytest.approx(varied.mapped(dot), abs=0.1)


def test_text_files_have_other_pixels_and_another_order() -> None:
    (tag,) = tags_from("7, (10.5 40.5), (40.5 40.5), (40.5 10.5), (10.5 10.5)\n")
    assert tag.id == 7
    assert tag.corners_px.tolist() == [[10, 10], [40, 10], [40, 40], [10, 40]]
    assert tag.centre_px == pytest.approx([25.0, 25.0])
    assert tag.edge_px == pytest.approx(30.0)
    with pytest.raises(VergenceError, match="expected a line"):
        tags_from("7, (10.5 40.5), (40.5 40.5)")


def test_what_counts_as_found() -> None:
    tag, other = known_tag(3, (50.0, 50.0), 30.0), known_tag(4, (90.0, 50.0), 30.0)
    near = known_tag(3, (51.0, 50.0), 30.0)
    seen = Found(3, near.centre_px, np.roll(near.corners_px, 1, axis=0))
    assert score([seen], tag, [tag, other], ordered=False).centre_error_px == pytest.approx(1.0)
    assert score([seen], tag, [tag, other], ordered=False).corner_error_px == pytest.approx(1.0)
    assert score([seen], tag, [tag, other], ordered=True).corner_error_px > 20.0
    far = Found(3, seen.centre_px + 5.0, seen.corners_px + 5.0)
    assert not score([far], tag, [tag, other], ordered=False).found


def test_what_counts_as_false() -> None:
    tag, other = known_tag(3, (50.0, 50.0), 30.0), known_tag(4, (90.0, 50.0), 30.0)
    found = [Found(one.id, one.centre_px, one.corners_px) for one in (tag, other)]
    right = score(found, tag, [tag, other], ordered=False)
    assert (right.wrong, right.stray) == ((), ())
    swapped = [Found(4, tag.centre_px, tag.corners_px), Found(9, tag.centre_px, tag.corners_px)]
    false = score(swapped, tag, [tag, other], ordered=False)
    assert (false.wrong, false.stray) == ((9,), (4,))


@pytest.fixture
def folder(tmp_path):
    """A folder with a photograph of a drawn tag, and its text file."""
    photograph = photograph_of_a_tag()
    (tmp_path / "drawn").mkdir()
    cv2.imwrite(str(tmp_path / "drawn" / "one.png"), photograph.image)
    listed = photograph.tags[0].corners_px[::-1] + 0.5
    line = ", ".join(f"({x:.4f} {y:.4f})" for x, y in listed)
    (tmp_path / "drawn" / "one.txt").write_text(f"5, {line}\n")
    return tmp_path


def test_methods_agree_on_the_coordinates_of_a_drawn_tag() -> None:
    """Half a pixel is what conventions differ by; the image is sharp."""
    photograph = photograph_of_a_tag(pixels=20)
    blurred = cv2.GaussianBlur(photograph.image, (0, 0), 0.7)
    names = ("pyapriltags", "pyapriltags+sharpening", "aruco", "aruco-apriltag")
    methods = make_methods(names, "36h11", lambda text: None)
    assert len(methods) >= 2
    for one in methods:
        got = score(one.detect(blurred), photograph.tags[0], photograph.tags, one.ordered)
        assert got.found
        assert got.centre_error_px < 0.1
        assert got.corner_error_px < (0.25 if one.refined else 1.0)


def test_one_command_makes_the_table(folder, capsys) -> None:
    csv, js = folder / "table.csv", folder / "table.json"
    kept = ["--csv", str(csv), "--json", str(js)]
    main([str(folder), "--methods", "aruco", "--quick", "--repeats", "1", *kept])
    table = pd.read_csv(csv).set_index("variation")
    assert table.loc["as it is", "rate"] == 1.0
    assert table.loc["total", "tags"] == sum(one.quick for one in VARIATIONS)
    assert table.loc["total", "wrong"] == 0
    assert "| as it is | 1 | 100.0 / " in capsys.readouterr().out
    assert js.read_text().startswith("{")


def test_images_in_which_a_target_is_found_are_listed(folder, capsys) -> None:
    cv2.imwrite(str(folder / "empty.png"), np.full((99, 99), 128, np.uint8))
    targets = ["--target", "tag:36h11", "tag:36h11:5", "tag:36h11:6"]
    false_positives.main([str(folder), "--method", "aruco", *targets])
    said = capsys.readouterr().out
    assert "tag:36h11: 1 in 1 of 2 images" in said
    assert "tag:36h11:5: 1 in 1 of 2 images" in said
    assert "tag:36h11:6: 0 in 0 of 2 images" in said
    assert "drawn/one.png: 5 at" in said
