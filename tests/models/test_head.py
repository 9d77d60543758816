"""The head as a value: identity, digest, copies, populations, perturbation."""

import dataclasses
import os
import pickle
import subprocess
import sys

import numpy as np
import pytest

from tests.heads import text_of
from tests.models.lenses import wide
from tests.naming import refused
from vergence.models import ModelErrors, load_head, parse_head


def nudged(head, part, field, index):
    """The head with one number changed a little, another lens, flag or side of its encoders."""
    value = getattr(getattr(head, part), field)
    if isinstance(value, tuple):
        value = list(value)
        value[index[0]] = "srgb" if field == "response" else "fisheye"
        value = tuple(value)
    elif np.shape(value):
        value = value.copy()
        value[index] += 1 if value.dtype == int else 1e-9
    elif isinstance(value, bool | str):
        value = "output" if value == "motor" else not value
    else:
        value += 1 if isinstance(value, int) else 1e-9
    return head.replace(**{part: {field: value}})


def test_the_digest_changes_with_any_number_flag_or_word(physical):
    # no fifth coefficient, which a fisheye lacks
    physical = physical.replace(cameras={"distortion": 0.01 * np.ones((2, 4))})
    camera = ("size", "focal", "principal", "lens", "distortion", "response", "pose")
    digests = [
        nudged(physical, part, field, index).digest
        for part in ("links", "cameras", "limits", "timing", "sensor", "rendering")
        for field in (camera if part == "cameras" else vars(getattr(physical, part)))
        for index in np.ndindex(np.shape(getattr(getattr(physical, part), field)))
    ]
    assert len(digests) > 100
    assert len({physical.digest, *digests}) == len(digests) + 1


def test_the_presets_keep_the_digests_that_bundles_and_tuned_options_name(simulated, physical):
    for head, digest in [
        (simulated, "a2ab725a9b004002cdf8a148ac1ee224722901d3a91846794c649ad30453cc12"),
        (physical, "906730e6530f5a5a8c0f2f656a0eadef2b0222584ca9b835a51f567b913d4518"),
    ]:
        assert head.digest == digest


def test_what_rounding_leaves_of_a_latency_or_a_pose_is_no_other_head(simulated):
    # a decimal's rounding makes no other head
    same = simulated.replace(timing={"latency_s": 0.066666666666667})
    assert same.digest == simulated.digest
    between = simulated.replace(timing={"latency_s": 0.0708})
    nearest = simulated.replace(timing={"latency_s": between.timing.latency_frames / 120.0})
    assert between.digest not in (simulated.digest, nearest.digest)
    head = parse_head(text_of("panfirst"))
    for nudge, same in ((1e-16, True), (1e-9, False)):
        links = dataclasses.replace(head.links, pose=head.links.pose + nudge)
        assert (dataclasses.replace(head, links=links).digest == head.digest) is same


def test_the_digest_of_other_cameras_is_of_the_same_form_ever_after(physical):
    same = physical.replace(cameras={"size": (640, 480), "lens": "brown-conrady"})
    assert same.digest == physical.digest
    digest = wide("fisheye", "rational").digest
    assert digest != wide("rational", "fisheye").digest
    assert digest == "16ccd2facc796eefe3d8f773451b155001714bc6ce039ca9b970d93a784375c7"


@pytest.mark.nightly
def test_a_head_is_the_same_on_another_processor():
    # OpenBLAS, which NumPy comes with on most machines, sums as the processor likes best
    tilted = "axis = [0.0131, 0.9987, -0.0271]\nrpy_rad = [0.013, -0.02, 0.041]"
    text = text_of("panfirst").replace("axis = [0.0, 1.0, 0.0]", tilted)
    assert text.count("0.0131") == 2
    code = "import sys, vergence.models as m; print(m.parse_head(sys.stdin.read()).digest)"
    run = subprocess.run(
        [sys.executable, "-c", code], input=text, text=True, capture_output=True, check=True,
        env=os.environ | {"OPENBLAS_CORETYPE": "Prescott"},
    )  # fmt: skip
    assert run.stdout.split() == [parse_head(text).digest]


def test_heads_are_equal_by_name_and_numbers(simulated, physical, head):
    again = load_head("simulated")
    assert again == simulated
    assert hash(again) == hash(simulated)
    other = simulated.replace(name="other")
    assert other.digest == simulated.digest
    for one in (physical, other, simulated.replace(timing={"lag_s": 0.031}), "simulated"):
        assert simulated != one
    head.camera_poses(np.zeros(7))
    copy = pickle.loads(pickle.dumps(head))
    assert copy == head
    np.testing.assert_array_equal(copy.packed, head.packed)


def test_arrays_are_the_heads_own_and_only_replaced_together(simulated):
    for array in (simulated.links.a, simulated.limits.upper, simulated.cameras.left.matrix):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1.0
    head_eye = simulated.head_eye.copy()
    head = simulated.replace(head_eye=head_eye)
    head_eye[:] = 0.0
    np.testing.assert_array_equal(head.head_eye, simulated.head_eye)
    head = simulated.replace(head_eye=np.tile(np.eye(4), (2, 1, 1)), cameras={"size": (64, 48)})
    assert head.cameras.left.size == (64, 48)
    np.testing.assert_array_equal(head.head_eye[0], np.eye(4))


def test_limits_keep_the_margin_and_contain_no_nan(simulated):
    limits = simulated.limits
    assert limits.contains(limits.upper)
    assert not limits.contains(limits.upper, margin=1e-6)
    assert not limits.contains(np.full(7, np.nan))


class TestPerturbation:
    def test_one_head_is_drawn_by_the_generator(self, physical, errors):
        first, again, other = (
            physical.perturbed(np.random.default_rng(seed), errors) for seed in (3, 3, 4)
        )
        assert first == again
        assert first != other
        same = physical.perturbed(np.random.default_rng(3), ModelErrors(), 2)
        np.testing.assert_allclose(same[1].packed, physical.packed, rtol=0, atol=1e-15)
        refused(r"one head.*\(2,\)", same.perturbed, np.random.default_rng(3), errors)

    def test_the_neck_and_all_but_the_geometry_stays(self, physical, errors, rng):
        drawn = physical.perturbed(rng, errors)
        for part in ("limits", "timing", "sensor"):
            assert getattr(drawn, part) is getattr(physical, part)
        for field, value in vars(physical.links).items():
            changed = (getattr(drawn.links, field) != value).tolist()
            # the last link of an eye is fixed: it has no joint offset to be wrong
            last = field != "offset"
            assert changed == [False] * 3 + [True, True, last] * 2, field

    def test_deviations_have_the_standard_deviations_asked_for(self, physical, errors, rng):
        heads = physical.perturbed(rng, errors, 4000)
        tilted = physical.perturbed(rng, ModelErrors(common_tilt_rad=0.02), 4000)
        lower = tilted.links.offset - physical.links.offset
        links, cameras = heads.links, heads.cameras
        relative = cameras.focal / physical.cameras.focal - 1.0
        turn = np.swapaxes(physical.head_eye[:, :3, :3], -1, -2) @ heads.head_eye[..., :3, :3]
        drawn = {
            "link_m": (links.a - physical.links.a)[:, 3:],
            "coaxiality_rad": (links.alpha - physical.links.alpha)[:, 3:],
            "joint_offset_rad": (links.offset - physical.links.offset)[:, [3, 4, 6, 7]],
            "head_eye_rad": turn[..., 2, 1],
            "head_eye_m": (heads.head_eye - physical.head_eye)[..., :3, 3],
            "focal_relative": relative,
            "principal_px": cameras.principal - physical.cameras.principal,
            "distortion": (cameras.distortion - physical.cameras.distortion)[..., :2],
            "common_tilt_rad": np.stack([lower[:, 3], -lower[:, 6]]),
        }
        assert drawn.keys() == vars(errors).keys()
        for name, values in drawn.items():
            sigma = getattr(errors, name) or 0.02
            # 4000 draws or more: 5 % is over four standard errors
            assert values.std() == pytest.approx(sigma, rel=0.05), name
            assert abs(values.mean()) < 0.06 * sigma, name
        np.testing.assert_allclose(relative[..., 0], relative[..., 1], atol=1e-12)
        square = turn @ np.swapaxes(turn, -1, -2)  # rotations
        np.testing.assert_allclose(square, np.broadcast_to(np.eye(3), square.shape), atol=1e-12)


def test_an_error_in_degrees_or_millimetres_or_below_zero_is_refused():
    degrees, millimetres = r"radians.*is it in degrees\?", r"metres.*is it in millimetres\?"
    for name, value, said in [
        ("joint_offset_rad", 5.7, degrees), ("common_tilt_rad", 1.4, degrees),
        ("head_eye_rad", 1.0, degrees), ("link_m", 0.5, millimetres),
        ("head_eye_m", 0.5, millimetres),
        *(("principal_px", value, ">= 0") for value in (-1.0, np.nan, np.inf)),
    ]:  # fmt: skip
        refused(f"{name}.*{said}", ModelErrors, **{name: value})
    # ten degrees, and a centimetre: what no calibration has seen
    ModelErrors(joint_offset_rad=0.17, head_eye_rad=0.17, link_m=0.01, head_eye_m=0.01)


def test_a_change_of_a_head_that_cannot_be_is_refused(simulated) -> None:
    for parts, message in [
        ({"timing": {"latency_frames": 8}}, r"timing\.latency_frames: expected one of control"),
        ({"timing": {"latency_s": np.nan}}, r"timing\.latency_s: expected a number"),
        ({"timing": {"control_rate_hz": 0.0}}, "control_rate_hz: expected a number above 0"),
        ({"timing": {"lag_s": "short"}}, r"timing\.lag_s: expected numbers"),
        ({"timing": 3}, r"head\.timing: expected a LoopTiming"),
        ({"timming": {"lag_s": 0.0}}, r"head\.timming: expected one of name, links"),
        ({"cameras": {"focal": np.nan}}, r"cameras\.focal: expected shape \(..., 2, 2\)"),
        ({"sensor": {"detection_noise_px": -1.0}}, "detection_noise_px: expected a number of at"),
        ({"limits": {"lower": [1.0, 2.0]}}, r"limits\.lower: expected shape \(7,\), got \(2,\)"),
    ]:
        refused(message, simulated.replace, **parts)
