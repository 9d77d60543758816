"""The head as a value: identity, copies, populations, perturbation."""

import pickle

import numpy as np
import pytest

from tests.naming import named
from vergence.errors import ConfigurationError
from vergence.models import ModelErrors, load_head


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
        with pytest.raises(ConfigurationError, match=r"one head.*\(2,\)"):
            same.perturbed(np.random.default_rng(3), errors)

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
        ({"limits": {"lower": [1.0, 2.0]}}, r"limits\.lower: expected numbers of shape \(..., 7\)"),
    ]:
        with named(parts, message), pytest.raises(ConfigurationError, match=message):
            simulated.replace(**parts)
