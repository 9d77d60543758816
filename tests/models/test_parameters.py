"""The geometry as a vector of named numbers: there and back, and what each name means."""

import numpy as np
import pytest

from tests.heads import TEXTS, head_of
from tests.models.lenses import COEFFICIENTS, wide
from tests.naming import named, refused
from vergence.models import ModelErrors


def moved(head, name: str, by: float):
    names, _units, values = head.parameters()
    values[names.index(name)] += by
    return head.with_parameters(values)


def test_another_head_comes_back_from_its_vector_about_the_model(physical, errors, rng):
    for head in (physical, wide("fisheye", "rational"), *map(head_of, TEXTS)):
        with named(head.name):
            true = head.perturbed(rng, errors, (2, 3))
            names, units, values = true.parameters(head)
            again = head.with_parameters(values)
            assert again.batch_shape == (2, 3)
            # rounding of rotation vectors
            np.testing.assert_allclose(again.packed, true.packed, rtol=1e-12, atol=1e-12)
            assert len(set(names)) == len(names) == len(units) == values.shape[-1]
            assert set(units) == {"m", "rad", "px", "1"}


def test_heads_of_other_joints_have_no_common_vector_or_population(physical, rng):
    other = head_of("tied")
    pair = physical.perturbed(rng, ModelErrors(), 2)
    for call, said in (
        (lambda: physical.parameters(other), "about: expected a head with the joints"),
        (lambda: physical.stack([physical, pair]), "batch shape of the first"),
        (lambda: physical.stack([physical, wide("fisheye")]), "with the lenses of the first"),
        (lambda: physical.stack([]), "one head or more, got none"),
        (lambda: physical.perturbed(rng, ModelErrors(), -1), "counts of 1 or more, got -1"),
    ):
        refused(said, call)


def test_a_name_says_which_number_it_is(head):
    names, units, values = head.parameters()
    for name, unit, of in [
        ("left.tilt.a", "m", lambda head: head.links.a[3]),
        ("left.pan.alpha", "rad", lambda head: head.links.alpha[4]),
        ("right.tilt.offset", "rad", lambda head: head.links.offset[6]),
        ("right.camera_link.d", "m", lambda head: head.links.d[8]),
        ("right.head_eye.y", "m", lambda head: head.head_eye[1, 1, 3]),
        ("left.camera.f_v", "px", lambda head: head.cameras.focal[0, 1]),
        ("right.camera.u_0", "px", lambda head: head.cameras.principal[1, 0]),
        ("right.camera.k3", "1", lambda head: head.cameras.distortion[1, 4]),
    ]:
        assert units[names.index(name)] == unit, name
        assert values[names.index(name)] == of(head), name
        assert of(moved(head, name, 1e-3)) == pytest.approx(of(head) + 1e-3, rel=1e-15), name


def test_every_parameter_moves_what_an_eye_sees(physical, random_poses):
    q, points = random_poses(physical, 20) * 0.2, np.array([0.05, -0.1, 0.8])
    before = physical.project(q, points)
    names = physical.parameters().names
    assert len(names) == 52  # 22 of links, 12 of head-eye transforms, 18 of cameras
    for name in names:
        change = np.abs(moved(physical, name, 1e-3).project(q, points) - before).max(axis=0)
        eye = 0 if name.startswith("left") else 1
        assert change[eye].max() > 0.0, name
        assert change[1 - eye].max() == 0.0, name
    # rotations are about the cameras' own axes
    q, angle = np.zeros(7), 0.01
    turned = moved(physical, "left.head_eye.rx", angle).camera_poses(q)[0, :3, :3]
    rest = physical.camera_poses(q)[0, :3, :3]
    c, s = np.cos(angle), np.sin(angle)
    np.testing.assert_allclose(rest.T @ turned, [[1, 0, 0], [0, c, -s], [0, s, c]], atol=1e-12)
    for shape in [(51,), (3, 53), ()]:
        refused(r"expected shape \(\.\.\., 52\)", physical.with_parameters, np.zeros(shape))


def test_a_lens_has_its_own_coefficients_by_name(rng):
    head = wide("fisheye", "rational")
    names, _units, values = head.parameters()
    named = dict(zip(names, values.tolist(), strict=True))
    for eye, lens, own in (
        ("left", "fisheye", ("k1", "k2", "k3", "k4")),
        ("right", "rational", ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")),
    ):
        of_eye = [name for name in names if name.startswith(f"{eye}.camera.")]
        assert of_eye == [f"{eye}.camera.{name}" for name in ("f_u", "f_v", "u_0", "v_0", *own)]
        assert tuple(named[f"{eye}.camera.{name}"] for name in own) == COEFFICIENTS[lens]
    # of errors, the first two radial coefficients of any lens
    drawn = head.perturbed(rng, ModelErrors(distortion=0.1), 200)
    moved = (drawn.cameras.distortion - head.cameras.distortion).std(axis=0)
    # of 200 draws, 5 % a standard deviation of the estimate
    assert moved[:, :2] == pytest.approx(np.full((2, 2), 0.1), rel=0.2)
    assert not moved[:, 2:].any()
