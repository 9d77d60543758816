"""Heads as TOML: nothing is lost, and what cannot be a head is refused by key and value."""

import copy
import dataclasses
import pickle
import re
import tomllib

import numpy as np
import pytest
import tomli_w

from tests.heads import text_of
from tests.models.lenses import COEFFICIENTS, LENSES, wide
from tests.naming import named
from vergence.errors import HeadFileError, UnknownNameError, UnreadableFileError, VergenceError
from vergence.models import load_head, parse_head, save_head
from vergence.models.head_file import head_to_toml
from vergence.models.parts import LINKS


@pytest.fixture
def content(physical) -> dict:
    return tomllib.loads(head_to_toml(physical))


DH = ("alpha_rad", "a_m", "d_m", "offset_rad")


def parse(content: dict):
    return parse_head(tomli_w.dumps(content))


def changed(content: dict, key: str, value: object) -> dict:
    """A copy in which a key has another value, or is missing if that is `...`."""
    fresh = copy.deepcopy(content)
    *path, last = key.replace("[", ".").replace("]", "").split(".")
    table = fresh
    for name in path:
        table = table[int(name) if name.isdigit() else name]
    if value is ...:
        del table[last]
    else:
        table[int(last) if last.isdigit() else last] = value
    return fresh


def test_an_unknown_preset_is_refused_with_the_known_ones():
    for name in ("nobody", 3):
        said = f"head: expected one of icub, physical, simulated, turrets.*{name!r}"
        with named(name), pytest.raises(UnknownNameError, match=said):
            load_head(name)


class TestRoundTrip:
    def test_file(self, head, tmp_path):
        path = tmp_path / "head.toml"
        save_head(head, path)
        assert load_head(path) == head
        assert load_head(str(path)) == head
        assert [entry.name for entry in tmp_path.iterdir()] == ["head.toml"]

    def test_no_acceleration_limit(self, simulated):
        free = simulated.replace(limits={"acceleration": np.full(7, np.inf)})
        assert parse_head(head_to_toml(free)) == free

    def test_the_response_of_each_eye(self, physical):
        for response in ("srgb", (2.2, None), (None, (0.0, 0.2, 1.0))):
            stated = physical.replace(cameras={"response": response})
            text = head_to_toml(stated)
            assert parse_head(text).cameras.response == stated.cameras.response
            assert text.count("response = ") == 2 - stated.cameras.response.count(None)
        assert "response" not in head_to_toml(physical)

    def test_a_population_is_refused(self, physical, errors, rng, tmp_path):
        with pytest.raises(HeadFileError, match=r"one head.*\(3,\)"):
            save_head(physical.perturbed(rng, errors, 3), tmp_path / "heads.toml")
        assert not list(tmp_path.iterdir())


class TestFiles:
    def test_a_missing_file_that_is_called_like_a_preset_is_told_so(self):
        with pytest.raises(UnreadableFileError, match=r"--head simulated is the preset"):
            load_head("simulatd.toml")

    def test_a_name_that_no_file_has_is_refused(self):
        for name in ["x" * 5000 + ".toml", "nul\0in it.toml", "x" * 5000]:
            with named(name), pytest.raises(VergenceError):
                load_head(name)

    def test_bytes_that_are_no_text(self, tmp_path):
        for data in [b"\xff\xfe\x00", b'name = "K\xf6pfchen"']:
            with named(data):
                path = tmp_path / "noise.toml"
                path.write_bytes(data)
                with pytest.raises(UnreadableFileError, match=r"noise\.toml.*not text"):
                    load_head(path)

    def test_a_byte_order_mark_is_read_over(self, physical, tmp_path):
        path = tmp_path / "windows.toml"
        path.write_text(head_to_toml(physical), encoding="utf-8-sig")
        assert load_head(path) == physical

    def test_a_file_at_fault_is_named_before_what_is_wrong_with_it(self, tmp_path):
        for text, said in [
            ("", r"my\.toml: name: expected a name .*the key is missing"),
            ("name = 'x'\nlinks = [", r"my\.toml: TOML: expected a well-formed .*at end of"),
            ("a = " + "[" * 10_000, r"my\.toml: TOML: .*recursion"),
            ("a = " + "1" * 5000, r"my\.toml: TOML: .*digits"),
        ]:
            with named(text, said):
                path = tmp_path / "my.toml"
                path.write_text(text)
                with pytest.raises(HeadFileError, match=said):
                    load_head(path)

    @pytest.mark.parametrize("value", ["-3.0", hex(16**5000)])
    def test_a_key_at_fault_comes_with_the_file(self, content, tmp_path, value):
        content["joints"][2]["velocity_rad_s"] = 123454321
        path = tmp_path / "my.toml"
        path.write_text(tomli_w.dumps(content).replace("123454321", value))
        with pytest.raises(HeadFileError) as caught:
            load_head(path)
        assert str(caught.value).startswith(f"{path}: joints[2].velocity_rad_s: expected rad/s")
        assert caught.value.key == "joints[2].velocity_rad_s"
        assert caught.value.file == str(path)
        again = pickle.loads(pickle.dumps(caught.value))
        assert str(again) == str(caught.value)


class TestNames:
    def test_a_name_that_could_not_be_part_of_a_files_name_is_refused(self, content):
        for name in (
            "../../../x", "a\\b", "..", ".hidden", "-x", " x", "x ", "x.", "", "a\nb", "a:b", "con",
            "NUL.toml", "x" * 65, "漢" * 64, 3,
        ):  # fmt: skip
            with named(name):
                with pytest.raises(HeadFileError, match="a name that a file may have") as caught:
                    parse(changed(content, "name", name))
                assert caught.value.key == "name"

    def test_other_names_are_kept(self, content):
        for name in ["7", "my head 2", "v1.2-b_3", "Köpfchen", "console", "x" * 64]:
            with named(name):
                assert parse(changed(content, "name", name)).name == name

    def test_a_head_is_not_saved_under_a_name_that_could_not_be_read(self, simulated, tmp_path):
        with pytest.raises(HeadFileError, match="a name that a file may have"):
            save_head(dataclasses.replace(simulated, name="../x"), tmp_path / "head.toml")
        assert not list(tmp_path.iterdir())


def test_an_unknown_key_is_named(content):
    for key in ["colour", "timing.colour", "joints[2].colour", "sensor.colour"]:
        with named(key):
            with pytest.raises(HeadFileError, match="expected no such key, got 1") as caught:
                parse(changed(content, key, 1))
            assert caught.value.key == key


def test_a_missing_key_is_named(content):
    for key in (
        "name", "eyes", "image.width_px", "joints[0].a_m", "eyes[1].focal_px",
        "joints[1].velocity_rad_s", "timing.lag_s", "timing.latency_s", "sensor.detection_noise_px",
        "rendering.blur_px",
    ):  # fmt: skip
        with named(key):
            with pytest.raises(HeadFileError, match="the key is missing") as caught:
                parse(changed(content, key, ...))
            assert caught.value.key == key


def test_wrong_units_are_refused_by_key_and_value(content):
    for key, value, unit in [
        ("joints[1].d_m", 64.27, "millimetres"), ("joints[3].a_m", 13.8, "millimetres"),
        ("eyes[0].position_m[2]", -5.0, "millimetres"),
        ("joints[1].alpha_rad", 90.0, "degrees"), ("joints[4].offset_rad", -90.0, "degrees"),
        ("joints[0].upper_rad", 60.0, "degrees"), ("joints[3].velocity_rad_s", 343.8, "degrees"),
        ("sensor.encoder_resolution_rad", 0.5, "degrees"),
        ("timing.exposure_s", 4.0, "milliseconds"), ("timing.lag_s", 30, "milliseconds"),
        ("timing.latency_s", 66.7, "milliseconds"),
    ]:  # fmt: skip
        with named(key, value, unit):
            said = f"{re.escape(key)}: expected .*{unit}.*got {value}"
            with pytest.raises(HeadFileError, match=said) as caught:
                parse(changed(content, key, value))
            assert (caught.value.key, caught.value.value) == (key, value)


def test_a_value_that_cannot_be_right_is_refused_by_key(content):
    for key, value in [
        ("name", ""), ("image.width_px", 640.5), ("timing.lag_s", float("nan")),
        ("timing.lag_s", "fast"), ("timing.lag_s", True), ("timing.frame_rate_hz", 0.0),
        ("timing.exposure_s", 0.02), ("timing.latency_s", -0.01), ("joints[2].velocity_rad_s", 0.0),
        ("joints[1].part", "eye"), ("joints[1].name", "neck_yaw"), ("eyes", []),
        ("eyes[0].principal_px", [700.0, 200.0]), ("eyes[0].focal_px", [521.0]),
        ("eyes[1].name", "left"), ("eyes[0].rotation", [[1, 0, 0], [0, 1, 0], [0, 0, -1]]),
        ("timing.exposure_stamps", 1), ("timing.command_latency_s", 11.0),
        ("timing.feedback_latency_s", -0.01), ("sensor.encoder_side", "left"),
        ("sensor.command_resolution_rad_s", -1.0), ("sensor.backlash_rad", 1.0),
    ]:  # fmt: skip
        with named(key, value):
            with pytest.raises(HeadFileError, match=f"{re.escape(key)}.*: expected") as caught:
                parse(changed(content, key, value))
            assert caught.value.key == key


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


def test_crossed_limits_are_refused_by_joint(simulated):
    crossed = simulated.replace(limits={"lower": simulated.limits.upper})
    with pytest.raises(HeadFileError, match=r"limits of neck_yaw.*lower_rad below upper_rad"):
        parse_head(head_to_toml(crossed))


class TestNumberedLinks:
    """The older form of the article's head: nine links, and limits with seven numbers a key."""

    @pytest.fixture
    def older(self, content):
        rows = [
            {key: table.pop(key) for key in DH} for table in [*content["joints"], *content["eyes"]]
        ]
        order = [*range(5), 7, 5, 6, 8]
        content["links"] = [
            {"frame": frame, "parent": parent, "joint": joint} | rows[i]
            for (frame, parent, joint), i in zip(LINKS, order, strict=True)
        ]
        keys = ("lower_rad", "upper_rad", "velocity_rad_s", "acceleration_rad_s2")
        content["limits"] = {key: [joint[key] for joint in content["joints"]] for key in keys}
        del content["joints"]
        for eye in content["eyes"]:
            eye["head_eye_rotation"] = eye.pop("rotation")
            eye["head_eye_translation_m"] = eye.pop("position_m")
        return content

    def test_is_read_as_the_same_head(self, older, physical):
        assert parse(older) == physical

    def test_is_refused_by_its_own_keys(self, older):
        for key, value in [
            ("links[2].colour", 1), ("links[0].alpha_rad", 90.0), ("links[1].joint", "neck_pitch"),
            ("links[1].parent", 0), ("links", []), ("limits.velocity_rad_s[2]", 0.0),
            ("eyes[0].head_eye_translation_m[2]", -5.0),
        ]:  # fmt: skip
            with named(key, value):
                with pytest.raises(HeadFileError, match=f"{re.escape(key)}.*: expected") as caught:
                    parse(changed(older, key, value))
                assert caught.value.key == key


def test_eyes_given_by_dh_numbers_need_the_articles_joints_given_so(content):
    for key, value in [("joints[3].name", "tilt"), ("eyes[0].alpha_rad", ...)]:
        fresh = changed(content, key, value)
        if value is ...:
            for other in DH[1:]:
                del fresh["eyes"][0][other]
        with named(key), pytest.raises(HeadFileError, match="D-H numbers of the joints neck_yaw"):
            parse(fresh)


class TestLatency:
    def test_an_older_file_counts_control_periods(self, content, physical):
        del content["timing"]["latency_s"]
        content["timing"]["latency_frames"] = 8
        assert parse(content).timing == physical.timing

    def test_both_ways_to_say_it_are_refused(self, content):
        content["timing"]["latency_frames"] = 8
        with pytest.raises(HeadFileError, match="one of latency_s and latency_frames"):
            parse(content)

    def test_a_negative_number_of_control_periods_is_refused(self, content):
        del content["timing"]["latency_s"]
        content["timing"]["latency_frames"] = -1
        with pytest.raises(HeadFileError) as caught:
            parse(content)
        assert caught.value.key == "timing.latency_frames"


class TestSingularGeometry:
    def test_eyes_in_one_place_are_refused(self, simulated):
        d = simulated.links.d.copy()
        # the right tilt axis points the other way: this brings both eyes together
        d[6] = -d[3]
        with pytest.raises(HeadFileError, match=r"above 1 mm.*baseline of .* m\b"):
            parse_head(head_to_toml(simulated.replace(links={"d": d})))

    def test_parallel_tilt_and_pan_are_refused(self, simulated):
        for link, eye in [(4, "left"), (7, "right")]:
            with named(link, eye):
                alpha = simulated.links.alpha.copy()
                alpha[link], alpha[link + 1] = 0.0, alpha[link] + alpha[link + 1]
                with pytest.raises(HeadFileError, match=f"joints of the {eye} eye.*two directions"):
                    parse_head(head_to_toml(simulated.replace(links={"alpha": alpha})))


class TestCameras:
    def test_lenses_and_sizes_of_each_eye_are_kept(self):
        for right in LENSES:
            for left in LENSES:
                with named(right, left):
                    head = wide(left, right)
                    again = parse_head(head_to_toml(head))
                    assert again == head
                    np.testing.assert_array_equal(again.packed, head.packed)
                    assert again.cameras.lens == (left, right)

    def test_a_head_of_the_first_form_is_written_in_the_first_form(self, head):
        content = tomllib.loads(head_to_toml(head))
        assert set(content["image"]) == {"width_px", "height_px"}
        for eye in content["eyes"]:
            assert len(eye["distortion"]) == 5
            assert not {"lens", "width_px", "height_px"} & set(eye)

    def test_a_file_says_lens_and_size_by_eye(self, content):
        del content["image"]
        for eye, size in zip(content["eyes"], ((640, 480), (1280, 720)), strict=True):
            eye["width_px"], eye["height_px"] = size
        content["eyes"][1] |= {"lens": "fisheye", "distortion": list(COEFFICIENTS["fisheye"])}
        cameras = parse(content).cameras
        assert cameras.size.tolist() == [[640, 480], [1280, 720]]
        assert cameras.lens == ("brown-conrady", "fisheye")
        assert tuple(cameras.distortion[1, :4]) == COEFFICIENTS["fisheye"]

    def test_coefficients_of_a_quotient_may_be_large(self, content):
        k = [22.4, 5.9, 0.001, -0.002, 0.21, 22.8, 14.2, 1.5]
        content["eyes"][0] |= {"lens": "rational", "distortion": k}
        assert parse(content).cameras.distortion[0].tolist() == k

    def test_what_no_camera_has_is_refused_by_key(self, content):
        for change, key, expected in [
            ({"lens": "pinhole"}, "eyes[1].distortion", "zeros, or no such key"),
            ({"lens": 5}, "eyes[1].lens", "one of pinhole, brown-conrady, rational"),
            ({"lens": "fisheye"}, "eyes[1].distortion", "list of 4 numbers"),
            ({"lens": "rational"}, "eyes[1].distortion", "list of 8 numbers"),
            ({"distortion": [12.0, 0, 0, 0, 0]}, "eyes[1].distortion[0]", "below 10 in size"),
            ({"response": "sRBG"}, "eyes[1].response", "'linear', 'srgb', a gamma"),
            ({"response": [0.0, 0.5]}, "eyes[1].response", "rising from 0 to 1"),
            ({"width_px": 320}, "eyes[1].width_px", "beside .image., which holds for both"),
        ]:
            with named(change, key, expected):
                fresh = copy.deepcopy(content)
                fresh["eyes"][1] |= change
                with pytest.raises(HeadFileError, match=expected) as caught:
                    parse(fresh)
                assert caught.value.key == key

    def test_without_an_image_each_eye_needs_its_size(self, content):
        del content["image"]
        content["eyes"][0] |= {"width_px": 640, "height_px": 480}
        with pytest.raises(HeadFileError, match="the key is missing") as caught:
            parse(content)
        assert caught.value.key == "eyes[1].width_px"

    def test_a_principal_point_lies_in_its_own_eyes_image(self, content):
        del content["image"]
        for eye, width in zip(content["eyes"], (640, 320), strict=True):
            eye |= {"width_px": width, "height_px": 480}
        with pytest.raises(HeadFileError, match="inside the image of 320 x 480 px") as caught:
            parse(content)
        assert caught.value.key == "eyes[1].principal_px"


def test_another_unit_is_asked_after_only_where_it_would_explain_the_value():
    for old, new, key, expected, hint in [
        ("lower_rad = -0.9", "lower_rad = -51.6", "joints[0].lower_rad", "radians", True),
        ("lower_rad = -0.9", "lower_rad = nan", "joints[0].lower_rad", "radians", False),
        ("lower_rad = -0.9", "lower_rad = '-0.9'", "joints[0].lower_rad", "radians", False),
        ("velocity_rad_s = 5.0", "velocity_rad_s = -5", "joints[0].velocity_rad_s", "rad/s", False),
        ("velocity_rad_s = 5.0\n", "", "joints[0].velocity_rad_s", "rad/s", False),
        ("latency_s = 0.0", "latency_s = -1.0", "timing.latency_s", "seconds", False),
    ]:
        with named(old, new, key, expected, hint):
            text = text_of("panfirst")
            if "latency" in old:
                text, old = re.sub(r"\nlatency_s = .*", "\n" + new, text), new
            with pytest.raises(HeadFileError) as caught:
                parse_head(text.replace(old, new, 1))
            assert str(caught.value).startswith(f"{key}: expected {expected}")
            assert ("is it in" in str(caught.value)) == hint


def test_eyes_in_the_wrong_order_are_told_which_comes_first():
    text = text_of("pair").replace('"left"', '"x"').replace('"right"', '"left"')
    with pytest.raises(HeadFileError, match="the left eye comes first"):
        parse_head(text.replace('"x"', '"right"'))


def test_a_pinhole_is_a_lens_without_distortion():
    text = text_of("pair")
    zeros = "distortion = [0.0, 0.0, 0.0, 0.0, 0.0]"
    assert zeros in text
    plain = parse_head(text)
    for lens in ('lens = "pinhole"', f'lens = "pinhole"\n{zeros}'):
        head = parse_head(text.replace(zeros, lens))
        assert head.digest == plain.digest
        assert parse_head(head_to_toml(head)).digest == plain.digest


def test_a_file_that_is_not_there_and_a_folder_are_told_first(tmp_path):
    (tmp_path / "head.toml").mkdir()
    with pytest.raises(UnreadableFileError, match=r"head\.toml.*Is a directory"):
        load_head(tmp_path / "head.toml")
    with pytest.raises(UnreadableFileError, match=r"^nothing\.toml: No such file") as caught:
        load_head("nothing.toml")
    assert str(pickle.loads(pickle.dumps(caught.value))) == str(caught.value)
