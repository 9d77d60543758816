"""The head as a value: identity, copies, populations, perturbation."""

import pickle

import numpy as np
import pytest

from tests.naming import named
from vergence.errors import ConfigurationError
from vergence.models import ModelErrors, load_head

CAMERA = ("size", "focal", "principal", "lens", "distortion", "response")
PARTS = ("links", "cameras", "limits", "timing", "sensor", "rendering")


def numbers(head):
    for part in PARTS:
        own = getattr(head, part)
        fields = {name: getattr(own, name) for name in CAMERA} if part == "cameras" else vars(own)
        for field, value in fields.items():
            for index in np.ndindex(np.shape(value)):
                yield part, field, index
    for index in np.ndindex(head.head_eye.shape):
        yield "head_eye", "", index


def nudged(head, part, field, index):
    """The head with one number changed a little, another lens, flag or side of its encoders."""
    value = head.head_eye if part == "head_eye" else getattr(getattr(head, part), field)
    if np.shape(value):
        names = isinstance(value, tuple)
        value = np.array(value, object if names else None)
        other = "srgb" if field == "response" else "fisheye"
        value[index] = other if names else value[index] + (1 if value.dtype == int else 1e-9)
        value = tuple(value.tolist()) if names else value
    elif isinstance(value, bool):
        value = not value
    elif isinstance(value, str):
        value = "output"
    else:
        value = value + 1 if isinstance(value, int) else value + 1e-9
    return head.replace(**{part: value if part == "head_eye" else {field: value}})


class TestIdentity:
    def test_digest_changes_with_any_number_flag_or_word(self, physical):
        # no fifth coefficient, which a fisheye lacks
        physical = physical.replace(cameras={"distortion": 0.01 * np.ones((2, 4))})
        digests = {physical.digest}
        changes = list(numbers(physical))
        for change in changes:
            digests.add(nudged(physical, *change).digest)
        assert len(changes) > 100
        assert len(digests) == len(changes) + 1

    def test_equal_heads_are_equal_and_hash_the_same(self, simulated):
        again = load_head("simulated")
        assert again == simulated
        assert hash(again) == hash(simulated)
        assert simulated.replace(name="other").digest == simulated.digest

    def test_heads_with_another_name_or_number_differ(self, simulated, physical):
        assert simulated != physical
        assert simulated != simulated.replace(name="other")
        assert simulated != simulated.replace(timing={"lag_s": 0.031})
        assert simulated != "simulated"

    def test_pickle_gives_an_equal_head(self, head):
        head.camera_poses(np.zeros(7))
        copy = pickle.loads(pickle.dumps(head))
        assert copy == head
        np.testing.assert_array_equal(copy.packed, head.packed)


class TestImmutability:
    def test_arrays_cannot_be_written(self, simulated):
        for array in (simulated.links.a, simulated.limits.upper, simulated.cameras.left.matrix):
            with pytest.raises(ValueError, match="read-only"):
                array[0] = 1.0

    def test_a_head_keeps_its_own_copy_of_arrays(self, simulated):
        head_eye = simulated.head_eye.copy()
        head = simulated.replace(head_eye=head_eye)
        head_eye[:] = 0.0
        np.testing.assert_array_equal(head.head_eye, simulated.head_eye)


class TestLimits:
    def test_contains_keeps_the_margin(self, simulated):
        at_the_limit = simulated.limits.upper
        assert simulated.limits.contains(at_the_limit)
        assert not simulated.limits.contains(at_the_limit, margin=1e-6)

    def test_no_angle_is_not_within(self, simulated):
        assert not simulated.limits.contains(np.full(7, np.nan))


class TestPopulation:
    def test_a_population_cannot_be_perturbed_again(self, physical, errors, rng):
        heads = physical.perturbed(rng, errors, 2)
        with pytest.raises(ConfigurationError, match=r"one head.*\(2,\)"):
            heads.perturbed(rng, errors)


class TestPerturbation:
    def test_same_generator_same_head(self, physical, errors):
        first, second = (physical.perturbed(np.random.default_rng(3), errors) for _ in range(2))
        assert first == second
        assert first != physical.perturbed(np.random.default_rng(4), errors)

    def test_no_errors_leave_the_head_as_it_is(self, physical, rng):
        drawn = physical.perturbed(rng, ModelErrors())
        np.testing.assert_allclose(drawn.packed, physical.packed, rtol=0, atol=1e-15)

    def test_neck_limits_timing_and_sensors_stay(self, physical, errors, rng):
        drawn = physical.perturbed(rng, errors)
        assert drawn.limits is physical.limits
        assert drawn.timing is physical.timing
        assert drawn.sensor is physical.sensor
        for field in ("alpha", "a", "d", "offset"):
            drawn_neck = getattr(drawn.links, field)[:3]
            np.testing.assert_array_equal(drawn_neck, getattr(physical.links, field)[:3])

    def test_fixed_frames_have_no_joint_offset_to_be_wrong(self, physical, errors, rng):
        drawn = physical.perturbed(rng, errors)
        changed = (drawn.links.offset != physical.links.offset).tolist()
        assert changed == [False] * 3 + [True, True, False] * 2

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

    def test_drawn_rotations_are_rotations(self, physical, errors, rng):
        rotation = physical.perturbed(rng, errors, 100).head_eye[..., :3, :3]
        product = rotation @ np.swapaxes(rotation, -1, -2)
        np.testing.assert_allclose(product, np.broadcast_to(np.eye(3), product.shape), atol=1e-12)

    def test_refuses_what_is_no_standard_deviation(self):
        for value in [-1.0, np.nan, np.inf]:
            with named(value), pytest.raises(ConfigurationError, match=r"principal_px.*>= 0"):
                ModelErrors(principal_px=value)


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
    ]:
        with named(parts, message), pytest.raises(ConfigurationError, match=message):
            simulated.replace(**parts)
