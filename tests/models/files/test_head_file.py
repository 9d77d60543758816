"""Heads as TOML: nothing is lost, and what cannot be a head is refused by key and value."""

import copy
import dataclasses
import itertools
import re
import tomllib
from collections.abc import Sequence
from functools import reduce

import numpy as np
import pytest
import tomli_w
from scipy.spatial.transform import Rotation

from tests.heads import CENTRE, IMAGE, LOOP, actuator, eyes, head_of, joint, text_of
from tests.models.lenses import COEFFICIENTS, LENSES, wide
from tests.naming import named, refused
from vergence.errors import HeadFileError, UnknownNameError, UnreadableFileError, VergenceError
from vergence.models import load_head, parse_head, save_head
from vergence.models.head_file import head_to_toml
from vergence.models.parts import LINKS, CalibrationRecord
from vergence.models.toml_table import toml_text

DH = ("alpha_rad", "a_m", "d_m", "offset_rad")
ZEROS = "[0.0, 0.0, 0.0, 0.0, 0.0]"


@pytest.fixture
def content(physical) -> dict:
    return tomllib.loads(head_to_toml(physical))


def parse(content: dict, changes: dict | None = None):
    """The head of a content whose keys have other values, or are missing where that is `...`."""
    fresh = copy.deepcopy(content)
    for key, value in (changes or {}).items():
        *path, last = [int(x) if x.isdigit() else x for x in re.findall(r"\w+", key)]
        table = fresh
        for name in path:
            table = table[name]
        if value is ...:
            del table[last]
        else:
            table[last] = value
    return parse_head(tomli_w.dumps(fresh))


def refuse(content: dict, changes: dict, said: str, key: str) -> HeadFileError:
    error = refused(said, parse, content, changes, error=HeadFileError)
    assert error.key == key, changes
    return error


class TestRoundTrip:
    def test_file(self, head, tmp_path):
        path = tmp_path / "head.toml"
        save_head(head, path)
        assert load_head(path) == head
        assert load_head(str(path)) == head
        assert [entry.name for entry in tmp_path.iterdir()] == ["head.toml"]
        path.write_text(head_to_toml(head), encoding="utf-8-sig")  # with a byte order mark
        assert load_head(path) == head
        # a head of the first form is written in the first form
        content = tomllib.loads(head_to_toml(head))
        assert set(content["image"]) == {"width_px", "height_px"}
        for eye in content["eyes"]:
            assert len(eye["distortion"]) == 5
            assert not {"lens", "width_px", "height_px"} & set(eye)

    def test_lenses_and_sizes_of_each_eye_and_limits_that_are_none(self, simulated):
        free = simulated.replace(limits={"acceleration": np.full(7, np.inf)})
        for head in (free, *itertools.starmap(wide, itertools.product(LENSES, LENSES))):
            again = parse_head(head_to_toml(head))
            with named(head.name, head.cameras.lens):
                assert again == head
                np.testing.assert_array_equal(again.packed, head.packed)
                assert again.cameras.lens == head.cameras.lens

    def test_the_response_of_each_eye(self, physical):
        for response in ("srgb", (2.2, None), (None, (0.0, 0.2, 1.0))):
            stated = physical.replace(cameras={"response": response})
            text = head_to_toml(stated)
            assert parse_head(text).cameras.response == stated.cameras.response
            assert text.count("response = ") == 2 - stated.cameras.response.count(None)
        assert "response" not in head_to_toml(physical)

    def test_what_no_file_can_say_is_not_written(self, physical, errors, rng, tmp_path):
        for head, said in [
            (physical.perturbed(rng, errors, 3), r"one head.*\(3,\)"),
            (dataclasses.replace(physical, name="../x"), "a name that a file may have"),
            (physical.replace(sensor={"dropped_frame_probability": 5.0}), "below 1, got 5.0"),
        ]:
            refused(said, save_head, head, tmp_path / "head.toml", error=HeadFileError)
        assert not list(tmp_path.iterdir())


class TestFiles:
    def test_what_is_no_file_that_can_be_read_is_refused(self, tmp_path):
        (tmp_path / "head.toml").mkdir()
        noise = tmp_path / "noise.toml"
        for path, data, said in [
            ("simulatd.toml", None, "--head simulated is the preset"),
            ("nothing.toml", None, r"^nothing\.toml: No such file"),
            (tmp_path / "head.toml", None, r"head\.toml.*Is a directory"),
            (noise, b"\xff\xfe\x00", r"noise\.toml.*not text"),
            (noise, b'name = "K\xf6pfchen"', r"noise\.toml.*not text"),
        ]:
            if data:
                path.write_bytes(data)
            refused(said, load_head, path, error=UnreadableFileError)
        for name in ["x" * 5000 + ".toml", "nul\0in it.toml", "x" * 5000]:
            refused("expected", load_head, name, error=VergenceError)
        for name in ("nobody", 3):
            said = f"head: expected one of icub, physical, simulated, turrets.*{name!r}"
            refused(said, load_head, name, error=UnknownNameError)

    def test_a_file_at_fault_is_named_before_what_is_wrong_with_it(self, content, tmp_path):
        path = tmp_path / "my.toml"
        for text, said in [
            ("", r"my\.toml: name: expected a name .*the key is missing"),
            ("name = 'x'\nlinks = [", r"my\.toml: TOML: expected a well-formed .*at end of"),
            ("a = " + "[" * 10_000, r"my\.toml: TOML: .*recursion"),
            ("a = " + "1" * 5000, r"my\.toml: TOML: .*digits"),
        ]:
            path.write_text(text)
            refused(said, load_head, path, error=HeadFileError)
        key = "joints[2].velocity_rad_s"
        content["joints"][2]["velocity_rad_s"] = 123454321
        for value in ("-3.0", hex(16**5000)):
            path.write_text(tomli_w.dumps(content).replace("123454321", value))
            said = re.escape(f"{path}: {key}: expected rad/s")
            error = refused(f"^{said}", load_head, path, error=HeadFileError)
            assert (error.key, error.file) == (key, str(path))


def test_a_name_is_one_that_could_be_part_of_a_files_name(content):
    for name in (
        "../../../x", "a\\b", "..", ".hidden", "-x", " x", "x ", "x.", "", "a\nb", "a:b", "con",
        "NUL.toml", "x" * 65, "漢" * 64, 3,
    ):  # fmt: skip
        refuse(content, {"name": name}, "a name that a file may have", "name")
    for name in ["7", "my head 2", "v1.2-b_3", "Köpfchen", "console", "x" * 64]:
        with named(name):
            assert parse(content, {"name": name}).name == name


def test_unknown_and_missing_keys_and_wrong_values_are_refused_by_key(content):
    for key in ["colour", "timing.colour", "joints[2].colour", "sensor.colour"]:
        refuse(content, {key: 1}, "expected no such key, got 1", key)
    for key in (
        "name", "eyes", "image.width_px", "joints[0].a_m", "eyes[1].focal_px",
        "joints[1].velocity_rad_s", "timing.lag_s", "timing.latency_s", "sensor.detection_noise_px",
        "rendering.blur_px",
    ):  # fmt: skip
        refuse(content, {key: ...}, "the key is missing", key)
    for key, value in [
        ("image.width_px", 640.5), ("timing.lag_s", np.nan), ("timing.lag_s", "fast"),
        ("timing.lag_s", True), ("timing.frame_rate_hz", 0.0), ("timing.exposure_s", 0.02),
        ("timing.latency_s", -0.01), ("joints[2].velocity_rad_s", 0.0),
        ("joints[1].part", "eye"), ("joints[1].name", "neck_yaw"), ("eyes", []),
        ("eyes[0].principal_px", [700.0, 200.0]), ("eyes[0].focal_px", [521.0]),
        ("eyes[1].name", "left"), ("eyes[0].rotation", [[1, 0, 0], [0, 1, 0], [0, 0, -1]]),
        ("timing.exposure_stamps", 1), ("timing.command_latency_s", 11.0),
        ("timing.feedback_latency_s", -0.01), ("sensor.encoder_side", "left"),
        ("sensor.command_resolution_rad_s", -1.0), ("sensor.backlash_rad", 1.0),
    ]:  # fmt: skip
        refuse(content, {key: value}, f"{re.escape(key)}.*: expected", key)


def test_wrong_units_are_asked_after_where_they_would_explain_the_value(content):
    for key, value, unit in [
        ("joints[1].d_m", 64.27, "millimetres"), ("joints[3].a_m", 13.8, "millimetres"),
        ("eyes[0].position_m[2]", -5.0, "millimetres"), ("joints[0].lower_rad", -51.6, "degrees"),
        ("joints[1].alpha_rad", 90.0, "degrees"), ("joints[4].offset_rad", -90.0, "degrees"),
        ("joints[0].upper_rad", 60.0, "degrees"), ("joints[3].velocity_rad_s", 343.8, "degrees"),
        ("sensor.encoder_resolution_rad", 0.5, "degrees"),
        ("timing.exposure_s", 4.0, "milliseconds"), ("timing.lag_s", 30, "milliseconds"),
        ("timing.latency_s", 66.7, "milliseconds"),
    ]:  # fmt: skip
        said = f"{re.escape(key)}: expected .*is it in {unit}.*got {value}"
        assert refuse(content, {key: value}, said, key).value == value
    for key, value, unit in [
        ("joints[0].lower_rad", np.nan, "radians"), ("joints[0].lower_rad", "-0.9", "radians"),
        ("joints[0].velocity_rad_s", -5, "rad/s"), ("joints[0].velocity_rad_s", ..., "rad/s"),
        ("timing.latency_s", -1.0, "seconds"),
    ]:  # fmt: skip
        error = refuse(content, {key: value}, f"^{re.escape(key)}: expected {unit}", key)
        assert "is it in" not in str(error)


def test_what_no_camera_has_is_refused_by_key(content):
    own = {"image": ..., "eyes[0].width_px": 640, "eyes[0].height_px": 480}
    for changes, key, said in [
        ({"lens": "pinhole"}, "distortion", "zeros, or no such key"),
        ({"lens": 5}, "lens", "one of pinhole, brown-conrady, rational"),
        ({"lens": "fisheye"}, "distortion", "list of 4 numbers"),
        ({"lens": "rational"}, "distortion", "list of 8 numbers"),
        ({"distortion": [12.0, 0, 0, 0, 0]}, "distortion[0]", "below 10 in size"),
        ({"response": "sRBG"}, "response", "'linear', 'srgb', a gamma"),
        ({"response": [0.0, 0.5]}, "response", "rising from 0 to 1"),
        ({"width_px": 320}, "width_px", "beside .image., which holds for both"),
    ]:
        changes = {f"eyes[1].{name}": value for name, value in changes.items()}
        refuse(content, changes, said, f"eyes[1].{key}")
    refuse(content, own, "the key is missing", "eyes[1].width_px")
    own |= {"eyes[1].width_px": 320, "eyes[1].height_px": 480}
    refuse(content, own, "inside the image of 320 x 480 px", "eyes[1].principal_px")


def test_cameras_may_have_any_rate_and_the_loop_any_times(content):
    content["timing"] |= {"frame_rate_hz": 47.3, "latency_s": 0.0712, "command_latency_s": 0.011}
    content["timing"] |= {"feedback_latency_s": 0.003, "exposure_stamps": True}
    content["sensor"] |= {"command_resolution_rad_s": 0.024, "backlash_rad": 0.002}
    content["sensor"]["encoder_side"] = "output"
    head = parse(content)
    for part in ("timing", "sensor"):
        for name, value in content[part].items():
            assert getattr(getattr(head, part), name) == value
    assert parse_head(head_to_toml(head)) == head


def test_the_older_form_of_the_articles_head_is_read_and_refused_by_its_own_keys(content, physical):
    """Latencies in control periods, nine links, and limits with seven numbers a key."""
    older, key = {"timing.latency_s": ..., "timing.latency_frames": 8}, "timing.latency_frames"
    assert parse(content, older).timing == physical.timing
    refuse(content, {key: 8}, "one of latency_s and latency_frames", "timing")
    refuse(content, older | {key: -1}, "expected", key)
    rows = [{key: table.pop(key) for key in DH} for table in content["joints"] + content["eyes"]]
    content["links"] = [
        {"frame": frame, "parent": parent, "joint": joint} | rows[i]
        for (frame, parent, joint), i in zip(LINKS, [*range(5), 7, 5, 6, 8], strict=True)
    ]
    keys = ("lower_rad", "upper_rad", "velocity_rad_s", "acceleration_rad_s2")
    content["limits"] = {key: [joint[key] for joint in content["joints"]] for key in keys}
    del content["joints"]
    for eye in content["eyes"]:
        eye["head_eye_rotation"] = eye.pop("rotation")
        eye["head_eye_translation_m"] = eye.pop("position_m")
    assert parse(content) == physical
    for key, value in [
        ("links[2].colour", 1), ("links[0].alpha_rad", 90.0), ("links[1].joint", "neck_pitch"),
        ("links[1].parent", 0), ("links", []), ("limits.velocity_rad_s[2]", 0.0),
        ("eyes[0].head_eye_translation_m[2]", -5.0),
    ]:  # fmt: skip
        refuse(content, {key: value}, f"{re.escape(key)}.*: expected", key)


def test_geometry_that_no_head_can_have_is_refused(content, simulated):
    for changes in ({"joints[3].name": "tilt"}, {f"eyes[0].{key}": ... for key in DH}):
        refused("D-H numbers of the joints neck_y", parse, content, changes, error=HeadFileError)
    d = simulated.links.d.copy()
    # the right tilt axis points the other way: this brings both eyes together
    d[6] = -d[3]
    rows = [
        ({"limits": {"lower": simulated.limits.upper}},
         r"limits of neck_yaw.*lower_rad below upper_rad"),
        ({"links": {"d": d}}, r"above 1 mm.*baseline of .* m\b"),
    ]  # fmt: skip
    for link, eye in [(4, "left"), (7, "right")]:  # parallel tilt and pan
        alpha = simulated.links.alpha.copy()
        alpha[link], alpha[link + 1] = 0.0, alpha[link] + alpha[link + 1]
        rows.append(({"links": {"alpha": alpha}}, f"joints of the {eye} eye.*two directions"))
    for parts, said in rows:
        text = head_to_toml(simulated.replace(**parts))
        refused(said, parse_head, text, error=HeadFileError)
    text = text_of("pair").replace('"left"', '"x"').replace('"right"', '"left"')
    text = text.replace('"x"', '"right"')
    refused("the left eye comes first", parse_head, text, error=HeadFileError)


def desk(left: float, right: float) -> str:
    """Two eyes that pan and tilt, at places along x."""
    joints = "".join(
        joint(f"{eye}_pan", eye, (x, 0, 0), (0, 1, 0))
        + joint(f"{eye}_tilt", eye, CENTRE, (1, 0, 0))
        for eye, x in (("left", left), ("right", right))
    )
    return 'name = "desk"\n' + joints + IMAGE + eyes() + LOOP


def pair(left: Sequence[float], right: Sequence[float]) -> str:
    return 'name = "pair"\n' + IMAGE + eyes(left, right) + LOOP


def test_what_cannot_be_and_what_was_meant_is_told():
    assert parse_head(desk(-0.04, 0.04)).camera_poses(np.zeros(7))[1, 0, 3] == pytest.approx(0.04)
    panfirst, still = text_of("panfirst"), text_of("pair")
    pan, rolls = "axis = [0.0, 1.0, 0.0]", "axis = [0.0, 0.0, 1.0]"
    near, far = "lower_rad = -0.9\nupper_rad = 0.9", "lower_rad = 2.0\nupper_rad = 4.5"
    for text, said in [
        (desk(0.04, -0.04), r"are left and right exchanged.*got .*80\.0 mm"),
        (pair((0.05, 0, 0), (-0.05, 0, 0)), "are left and right exchanged"),
        (pair((0.05, 0, 0), (0.05, 0, 0)), "eyes: expected cameras at two places"),
        (pair((0, 0, 0), (0, 0, 0.1)), r"side by side.*axes 0 degrees apart.* 0\.0 mm beside"),
        # a joint that turns about the optical axis
        (panfirst.replace(pan, rolls, 1), "left_pan and left_tilt to move the image"),
        (text_of("common").replace(pan, rolls, 1), "joints moved by pan: expected pan, tilt each"),
        # before what follows from it
        (panfirst.replace(near, far, 1), r"limits of left_pan: expected .*of zero.*2\.0, 4\.5"),
        (desk(-0.04, 0.04) + actuator("tilt", "left_tilt = 1.0"),
         "none that moves left_pan, right_pan, right_tilt"),
        (text_of("tied").replace("eyes_tilt = 1.0", "eye_tilt = 1.0"),
         ": eyes_tilt, left_pan, right_pan, got 'eye_tilt'"),
        (text_of("common").replace("[[joints]]", "[[joint]]"),
         r"^joint: expected no such key \(is joints m"),
        (still.replace("[timing]\n", "[timing]\nlatency = 0.1\n"), r"key \(is timing.latency_s"),
        (still.replace(ZEROS, str([0.01] * 4), 1), "expected 5 numbers, or lens = 'fisheye'"),
        (still.replace(ZEROS, str([0.01] * 8), 1), "expected 5 numbers, or lens = 'rational'"),
        (still.replace("r_resolution_rad = 0.0", "r_resolution_rad = 0.0879", 1),
         "encoder_resolution_rad: .*is it in degrees"),
    ]:  # fmt: skip
        refused(said, parse_head, text, error=HeadFileError)


class TestCameras:
    def test_a_file_says_lens_and_size_by_eye(self, content):
        del content["image"]
        for eye, size in zip(content["eyes"], ((640, 480), (1280, 720)), strict=True):
            eye["width_px"], eye["height_px"] = size
        content["eyes"][1] |= {"lens": "fisheye", "distortion": list(COEFFICIENTS["fisheye"])}
        cameras = parse(content).cameras
        assert cameras.size.tolist() == [[640, 480], [1280, 720]]
        assert cameras.lens == ("brown-conrady", "fisheye")
        assert tuple(cameras.distortion[1, :4]) == COEFFICIENTS["fisheye"]
        k = [22.4, 5.9, 0.001, -0.002, 0.21, 22.8, 14.2, 1.5]
        content["eyes"][0] |= {"lens": "rational", "distortion": k}
        assert parse(content).cameras.distortion[0].tolist() == k

    def test_a_pose_may_be_given_by_the_angles_of_a_urdf(self, content):
        changes = {"eyes[1].rotation": ..., "eyes[1].rpy_rad": [0.1, -0.2, 0.3]}
        expected = Rotation.from_euler("xyz", [0.1, -0.2, 0.3]).as_matrix()  # about fixed axes
        np.testing.assert_allclose(parse(content, changes).head_eye[1, :3, :3], expected)

    def test_a_pinhole_is_a_lens_without_distortion(self):
        text, zeros = text_of("pair"), f"distortion = {ZEROS}"
        assert zeros in text
        for lens in ('lens = "pinhole"', f'lens = "pinhole"\n{zeros}'):
            head = parse_head(text.replace(zeros, lens))
            assert head.digest == parse_head(head_to_toml(head)).digest == parse_head(text).digest


def test_what_nobody_measured_of_a_preset_is_marked():
    for head in map(load_head, ("icub", "turrets")):
        with named(head.name):
            assert any("acceleration" in key for key in head.assumptions)
            assert {"timing.latency_s", "timing.lag_s"} <= set(head.assumptions)
            assert parse_head(head_to_toml(head)) == head


def test_the_icub_has_a_common_tilt_version_and_vergence():
    head = load_head("icub")
    assert head.actuation.names == ("eyes_tilt", "eyes_version", "eyes_vergence")
    origins = head.camera_poses(np.zeros(7))[:, :3, 3]
    np.testing.assert_allclose(origins, [[-0.034, 0, 0], [0.034, 0, 0]], atol=1e-9)
    np.testing.assert_allclose(np.rad2deg(head.limits.upper[[4, 6]]), [55.0, 30.0])
    # both eyes turn inwards under a positive vergence
    q = head.actuation.joints_of([0, 0, 0, 0, 0, 0.2, 0])
    axes = head.camera_poses(q)[:, :3, 2]
    assert axes[0, 0] > 0.05
    assert axes[1, 0] < -0.05


def test_the_turrets_pan_before_they_tilt():
    head = load_head("turrets")
    assert head.actuation.direct
    assert head.joints[3:] == ("left_pan", "left_tilt", "right_pan", "right_tilt")
    origins = head.camera_poses(np.zeros(7))[:, :3, 3]
    np.testing.assert_allclose(origins, [[-0.075, 0, 0], [0.075, 0, 0]], atol=1e-12)
    # 42.25 mm from pan to tilt, 61.5 mm up and 31.2 mm ahead of it to the camera
    up = head.camera_poses([0, 0, 0, 0, -np.pi / 2, 0, 0])[0, :3, 3]
    np.testing.assert_allclose(up, [-0.075, 0.0615 - 0.0312, -0.0312 - 0.0615], atol=1e-12)
    assert head.timing.frame_rate_hz == 30.0


RECORD = CalibrationRecord(
    target="checkerboard:9x6:24", views=24, rms_px=0.15, rms_heldout_px=0.16,
    corners_sha256="0123456789abcdef" * 4, versions="vergence 0.1.0, numpy 2.0.0",
    sigma={"left.camera.f_u": 0.8, "right.head_eye.x": 0.0001},
)  # fmt: skip


@pytest.fixture
def calibrated(physical):
    return dataclasses.replace(physical, calibration=RECORD)


def test_a_calibrations_record_is_kept_as_it_is_and_in_no_digest(calibrated, tmp_path):
    for head in (calibrated, dataclasses.replace(head_of("pair"), calibration=RECORD)):
        save_head(head, tmp_path / "head.toml")
        again = load_head(tmp_path / "head.toml")
        assert again == head
        assert again.calibration == RECORD
        assert head_to_toml(again) == head_to_toml(head)
        assert dataclasses.replace(head, calibration=None).digest == head.digest


def test_a_calibrations_record_is_of_one_geometry(calibrated, simulated, rng, errors):
    assert simulated.calibration is None
    assert "calibration" not in tomllib.loads(head_to_toml(simulated))
    drawn = calibrated.perturbed(rng, errors, 3)
    assert (drawn.calibration, drawn[1].calibration) == (None, None)
    assert calibrated.with_parameters(calibrated.parameters().values).calibration is None
    assert calibrated.calibration == RECORD
    assert calibrated.replace(timing={"lag_s": 0.0}).calibration == RECORD
    assert calibrated.replace(cameras={"focal": calibrated.cameras.focal + 1.0}).calibration is None


def test_what_cannot_be_a_calibrations_record_is_refused_by_its_key(calibrated):
    content = tomllib.loads(head_to_toml(calibrated))
    for name, value, said in [
        ("target", 9, "the board, such as 'checkerboard:9x6:24'"),
        ("views", 24.5, r"a whole number, 0 to 10000, got 24\.5"),
        ("rms_px", -0.1, r"a number of at least 0, got -0\.1"),
        ("rms_heldout_px", np.nan, "a number"),
        ("corners_sha256", "12ab", "64 hexadecimal digits"),
        ("versions", "", "names and versions of programs"),
        ("sigma", 1.0, r"a table, got 1\.0"),
        ("rms", 0.1, r"no such key \(is calibration\.rms_px meant\?\)"),
        ("views", ..., "a whole number.*the key is missing"),
    ]:
        key = f"calibration.{name}"
        refuse(content, {key: value}, f"{re.escape(key)}: expected {said}", key)
    changes = {"calibration.sigma": {"left.camera.f_u": -1.0}}
    refuse(content, changes, "a number of at", "calibration.sigma.left.camera.f_u")


def test_a_short_list_is_on_one_line_and_everything_is_read_back():
    document = {
        "axis": [0.0, -1.5e-9, float("inf")],
        "rotation": [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
        "many": [0.123456789012345 + i for i in range(9)], "words": ["a, b", "[\n 1,\n]", "c"],
        "text": "[\n    1,\n    2,\n]", "empty": [],
        "tables": [{"values": [1, 2]}, {"values": [True]}],
    }  # fmt: skip
    text = toml_text(document)
    assert tomllib.loads(text) == document
    lines = text.splitlines()
    assert "axis = [0.0, -1.5e-09, inf]" in lines
    assert "    [1.0, 0.0, 0.0]," in lines
    assert "values = [1, 2]" in lines
    assert max(map(len, lines)) <= 100


def test_values_nested_too_deep_to_be_written_out_are_called_so():
    deep = reduce(lambda inner, _: {"a": inner}, range(5000), {})
    error = HeadFileError("timing", deep, "a number")
    assert str(error) == "timing: expected a number, got values nested too deep"
