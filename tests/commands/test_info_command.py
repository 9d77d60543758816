"""`vergence info --head`: what one head is and can do."""

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest
from matplotlib.patches import Polygon

from tests.commands.called import call, refused
from tests.heads import MOVING, head_of, text_of
from tests.naming import named
from vergence import Noise, triangulate_gaze, triangulate_views
from vergence.commands.assumed import assumed_values
from vergence.eval.head_figure import compose_head
from vergence.eval.head_summary import summarise_head
from vergence.models import load_head, parse_head


@pytest.fixture
def told(capsys, tmp_path):
    """The numbers that are printed of a head of `tests.heads`, or of a file's text."""

    def tell(name: str, text: str | None = None) -> dict:
        path = tmp_path / f"{name}.toml"
        path.write_text(text or text_of(name), encoding="utf-8")
        assert call("info", "--head", path, "--json") == 0
        return json.loads(capsys.readouterr().out)

    return tell


@pytest.mark.slow
def test_every_number_is_printed(capsys, tmp_path, told):
    for name in ("pair", "tied", "panfirst"):
        with named(name):
            numbers = told(name)
            assert call("info", "--head", tmp_path / f"{name}.toml") == 0
            said = capsys.readouterr().out
            head = head_of(name)
            assert head.digest == numbers["digest"]
            for word in (
                head.digest[:12], f"{numbers['baseline_mm']:.2f} mm", *filter(None, head.joints),
                *head.actuation.names, *(f"depth error at {z} m" for z in ("0.5", "1", "2")),
            ):  # fmt: skip
                assert word in said
            assert "no error of calibration" in " ".join(said.split())
            assert ("do not move" in said) == (name not in MOVING)


def test_degrees_have_no_rounding_errors(told):
    text = text_of("tied").replace("lower_rad = -0.9", f"lower_rad = {-np.pi / 3}")
    assert told("tied", text)["joints"][0]["lower_deg"] == -60.0  # exactly


def test_a_heads_calibration_is_told(capsys, tmp_path, told, monkeypatch):
    monkeypatch.setenv("COLUMNS", "120")
    record = f"""
[calibration]
target = "checkerboard:9x6:24"
views = 24
rms_px = 0.1501
rms_heldout_px = 0.1604
corners_sha256 = "{"0123456789abcdef" * 4}"
versions = "numpy 2.0.0"

[calibration.sigma]
"left.camera.f_u" = 0.81
"left.camera.f_v" = 0.82
"right.head_eye.x" = 0.0001
"right.head_eye.y" = 0.0002
"right.head_eye.z" = 0.0003
"""
    numbers = told("pair", text_of("pair") + record)
    assert numbers["calibration"]["target"] == "checkerboard:9x6:24"
    assert numbers["calibration"]["rms_heldout_px"] == 0.1604
    assert numbers["calibration"]["sigma"]["right.head_eye.x"] == 0.0001
    assert numbers["digest"] == head_of("pair").digest
    assert call("info", "--head", tmp_path / "pair.toml") == 0
    said = capsys.readouterr().out
    for words in ("checkerboard:9x6:24, 24 views", "0.150 px", "held out 0.160", "0.81, 0.82 px",
                  "0.1, 0.2, 0.3 mm", "numpy 2.0.0"):  # fmt: skip
        assert words in said
    assert "principal point" not in said  # whose sigma the file does not have
    assert told("pair", text_of("pair"))["calibration"] is None


def test_the_depth_error_is_that_of_the_heads_own_noise_at_fixation(told):
    for name in ("panfirst", "tied"):
        head, errors = head_of(name), told(name)["depth_error_mm"]
        centre = head.camera_poses(head.rest())[:, :3, 3].mean(axis=0)
        for depth in (0.5, 1.0, 2.0):
            point = centre + [0.0, 0.0, depth]
            sigma = triangulate_gaze(head, head.fixate(point), Noise.of(head)).sigma[2]
            assert errors[f"{depth:g}"] == pytest.approx(1e3 * sigma, rel=1e-6), (name, depth)


def test_the_depth_error_of_a_fixed_pair_is_that_of_two_views_and_grows_with_the_square(told):
    head, errors = head_of("pair"), told("pair")["depth_error_mm"]
    q = head.rest()
    sigma = triangulate_views(head, q, head.project(q, [0.0, 0.0, 1.0])).sigma[2]
    assert errors["1"] == pytest.approx(1e3 * sigma, rel=1e-9)
    # z^2 / (f B) times the noise of a disparity, which is that of two pixels
    simple = 1e3 * 1.0 / (343.0 * 0.1) * 0.05 * np.sqrt(2.0)
    assert errors["1"] == pytest.approx(simple, rel=0.01)
    assert errors["2"] / errors["0.5"] == pytest.approx(16.0, rel=0.02)


def test_the_reach_of_a_fixed_pair_begins_where_both_images_have_the_point(told):
    # the pixel of the left image's right edge: 159.5 + 343 * 0.05 / z = 319.5
    numbers = told("pair")
    assert numbers["reach"]["nearest_m"] == pytest.approx(343.0 * 0.05 / 160.0, rel=0.01)
    assert numbers["reach"]["farthest_m"] == "inf"


def test_the_angles_of_a_wide_pair_are_told_where_both_see(told):
    reach = told("wide", text_of("pair").replace("0.05, 0.0, 0.0]", "0.5, 0.0, 0.0]"))["reach"]
    assert reach["distance_m"] == pytest.approx(2.0 * reach["nearest_m"])
    assert reach["distance_m"] > 2.0
    assert reach["left_deg"] > 5.0


def test_the_reach_of_moving_eyes_ends_where_a_joint_does(told):
    # panning inwards by 0.9 rad from 34 mm beside the middle, about axes 10 mm behind the camera
    nearest = told("mis")["reach"]["nearest_m"]
    assert nearest == pytest.approx(0.034 / np.tan(0.9), rel=0.02)
    # 1.2 rad of vergence turn either eye by 0.6
    assert told("tied")["reach"]["nearest_m"] == pytest.approx(0.034 / np.tan(0.6), rel=0.01)


@pytest.mark.slow
def test_what_tied_eyes_cannot_make_zero_is_told(told):
    assert told("panfirst")["least_error_px"] == 0.0
    assert 0.1 < told("mis")["least_error_px"] < 2.0
    assert told("common")["least_error_px"] > 10.0


def test_what_iterations_leave_is_no_pixel_error(capsys, monkeypatch):
    summary = summarise_head(load_head("turrets"))
    for least_px, said in ((2e-6, False), (0.02, True)):
        found = replace(summary, least_error_px=least_px)
        place = "vergence.eval.head_summary.summarise_head"
        monkeypatch.setattr(place, lambda _head, found=found: found)
        assert call("info", "--head", "turrets") == 0
        assert ("least pixel error" in capsys.readouterr().out) == said


def test_the_field_of_view_is_that_of_the_lens(told):
    barrel = text_of("pair").replace("[0.0, 0.0, 0.0, 0.0, 0.0]", "[-0.2, 0.02, 0.0, 0.0, 0.0]")
    eye = told("barrel", barrel)["eyes"][0]
    matrix = np.array([[343.0, 0.0, 159.5], [0.0, 343.0, 119.5], [0.0, 0.0, 1.0]])
    coefficients = np.array([-0.2, 0.02, 0.0, 0.0])
    half = np.radians(0.5 * eye["horizontal_deg"])  # the principal point is in the middle
    edge = np.array([[np.tan(half), 0.0, 1.0]])
    pixel = cv2.projectPoints(edge, np.zeros(3), np.zeros(3), matrix, coefficients)[0].ravel()
    assert pixel == pytest.approx([319.5, 119.5], abs=1e-6)
    assert eye["horizontal_deg"] > told("pair")["eyes"][0]["horizontal_deg"] + 1.0
    assert not eye["folds"]


def test_a_lens_that_folds_inside_the_image_is_warned_of(tmp_path, capsys, told):
    folding = text_of("pair").replace("[0.0, 0.0, 0.0, 0.0, 0.0]", "[-2.0, 0.0, 0.0, 0.0, 0.0]", 1)
    numbers = told("folding", folding)
    assert [eye["folds"] for eye in numbers["eyes"]] == [True, False]
    # d (r - 2 r^3) / dr = 0 at r^2 = 1/6
    fold_deg = 2.0 * np.degrees(np.arctan(np.sqrt(1.0 / 6.0)))
    assert numbers["eyes"][0]["horizontal_deg"] == pytest.approx(fold_deg, abs=1.0)
    assert call("info", "--head", tmp_path / "folding.toml") == 0
    warnings = capsys.readouterr().err.splitlines()
    assert len(warnings) == 1
    assert "left eye has no rays in a part of its image" in warnings[0]


FISHEYE = (
    text_of("pair")
    .replace("focal_px = [343.0, 343.0]", 'focal_px = [100.0, 100.0]\nlens = "fisheye"')
    .replace("[0.0, 0.0, 0.0, 0.0, 0.0]", "[0.0, 0.0, 0.0, 0.0]")
)
"""A pair that sees 180 degrees and more across."""


@pytest.mark.slow
def test_a_field_of_view_of_180_degrees_is_shaded():
    head = parse_head(FISHEYE)
    figure = compose_head(head, summarise_head(head))
    shades = [patch for patch in figure.axes[0].patches if isinstance(patch, Polygon)]
    assert len(shades) == 2
    for shade in shades:
        # 40 mm ahead of each eye and as far to either side
        for x in (-90.0, 0.0, 90.0):
            assert shade.get_path().contains_point((x, 40.0))


@pytest.mark.nightly
def test_the_drawing_is_written_where_it_is_wanted(tmp_path, capsys):
    path = tmp_path / "desk.png"
    head = tmp_path / "head.toml"
    head.write_text(text_of("pair"), encoding="utf-8")
    assert call("info", "--head", head, "--figure", path) == 0
    image = cv2.imread(str(path))
    assert image.shape[0] > 900
    assert image.shape[1] > 1200
    assert (image < 100).any()


def test_an_assumption_is_shown_with_its_value_and_unit(tmp_path, capsys):
    path = tmp_path / "head.toml"
    keys = {
        "timing.latency_s": "66.67 ms", "joints.left_pan.velocity_rad_s": "286.5 deg/s",
        "joints.acceleration_rad_s2": "80 rad/s^2", "acceleration_rad_s2": "80 rad/s^2",
        "image.width_px": "320 px", "eyes.right.focal_px": "343, 343 px",
        "sensor": "detection noise 0.05 px", "no.such.key": "",
    }  # fmt: skip
    lines = "".join(f'"{key}" = "reason{i}"\n' for i, key in enumerate(keys))
    path.write_text(f"{text_of('panfirst')}\n[assumptions]\n{lines}", encoding="utf-8")
    found = {a.keys[0]: a for a in assumed_values(load_head(path))}
    for i, (key, value) in enumerate(keys.items()):
        assert found[key].value.startswith(value)
        assert found[key].reason == f"reason{i}"
    assert call("info", "--head", path) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "66.67 ms reason0" in said


def test_why_an_eye_does_not_look_straight_at_a_point(tmp_path, capsys):
    path = tmp_path / "head.toml"
    for name, reason in (
        ("vergeonly", "each eye turns about one axis at most"), ("common", "the eyes are tied"),
    ):  # fmt: skip
        # eyes of different height cannot both look at a point by panning alone
        text = text_of(name).replace("[-0.03, 0, 0]", "[-0.03, 0.01, 0]")
        path.write_text(text.replace("[-0.03, 0.0, 0.0]", "[-0.03, 0.01, 0.0]"), encoding="utf-8")
        assert call("info", "--head", path) == 0
        said = " ".join(capsys.readouterr().out.split())
        assert f"at these depths and sides: {reason}" in said


def test_a_range_without_zero_is_warned_of(tmp_path, capsys):
    path = tmp_path / "head.toml"
    text = text_of("panfirst").replace("lower_rad = -0.9", "lower_rad = 0.2", 1)
    path.write_text(text, encoding="utf-8")
    assert call("info", "--head", path) == 0
    (line,) = capsys.readouterr().err.splitlines()
    assert "range of left_pan, 11.5 to 51.6 degrees, is without zero" in line


def test_what_cannot_be_shown_is_refused_in_one_line(capsys):
    for words, said in [
        (["--head", "none"], "expected one of"), (["--head", "none.toml"], "No such file"),
        (["--json"], "--head"), (["--figure", "a.png"], "--head"),
        (["--head", "simulated", "--figure", "desk.jpg"], "ends in .png"),
        (["--head", "physical", "--figure", "nodir/x.png"], "expected a file that can be written"),
    ]:  # fmt: skip
        assert said in refused(capsys, "info", *words)
