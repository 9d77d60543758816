"""The lens, there and back."""

import numpy as np
import pytest

from tests.grids import some_of
from tests.models.lenses import LENSES, wide
from tests.naming import named, refused
from tests.vision.scenes import rig
from vergence.models.camera import Lens, camera_matrix
from vergence.vision import Camera

EYE = rig("physical")[0]


def test_rays_undo_projection_over_the_whole_frame() -> None:
    u, v = np.meshgrid(np.linspace(-8, 648, 40), np.linspace(-8, 488, 30))
    pixels = np.stack([u.ravel(), v.ravel()], axis=-1)
    rays = EYE.rays(pixels)
    again = EYE.project(np.column_stack([rays, np.ones(len(rays))]))
    assert np.abs(again - pixels).max() < 1e-4


def test_an_eye_of_any_lens_sees_what_its_head_projects() -> None:
    for left, right in some_of(LENSES, LENSES):
        with named(left, right):
            head = wide(left, right)
            q, points = np.zeros(7), np.array([[0.3, -0.15, 0.5], [-0.2, 0.3, 0.7]])
            for eye, T_N_C in enumerate(head.camera_poses(q)):
                camera = Camera.of(head, eye)
                assert (camera.width, camera.height) == tuple(head.cameras.size[eye])
                in_camera = (points - T_N_C[:3, 3]) @ T_N_C[:3, :3]
                pixels = camera.project(in_camera)
                np.testing.assert_allclose(pixels, head.project(q, points)[:, eye], atol=1e-9)
                np.testing.assert_allclose(camera.rays(pixels), in_camera[:, :2] / in_camera[:, 2:])


def test_a_camera_without_coefficients_is_that_of_zeros() -> None:
    view = {"size": (640, 480), "matrix": camera_matrix((300, 300), (319.5, 239.5))}
    assert not Camera(**view).distorts
    assert Camera(**view).inverse_matrix @ Camera(**view).matrix == pytest.approx(np.eye(3))
    assert not Camera(**view, lens=Lens("rational")).distorts
    assert Camera(**view, lens=Lens("fisheye")).distorts
    assert Camera(**view, lens=Lens("fisheye")).lens.coefficients.tolist() == [0.0] * 4
    assert {Camera(**view), Camera(**view), Camera(**view, lens=Lens("fisheye"))} == {
        Camera(**view), Camera(**view, lens=Lens("fisheye")),
    }  # fmt: skip


def test_what_cannot_be_a_camera_is_refused() -> None:
    view = {"size": (4, 4), "matrix": camera_matrix((1, 1), (0, 0))}
    for change, said in (
        ({"lens": Lens("brown-conrady", (0.1, 0.2))}, "distortion: expected 5 numbers, got 2"),
        ({"lens": Lens("fisheye", (0.1,) * 5)}, "distortion: expected 4 numbers, got 5"),
        ({"lens": Lens("mirror")}, "lens: expected one of brown-conrady, rational"),
        ({"matrix": camera_matrix((-1, 1), (0, 0)).tolist()}, "positive"),
        ({"lens": Lens("fisheye", (0.1, 0.0, np.nan, 0.0))}, "distortion: expected numbers"),
        ({"matrix": [[1.0, 0.1, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]}, "matrix: expected a cam"),
        ({"matrix": np.eye(2)}, "matrix: expected a camera matrix"),
        ({"size": (640.5, 480)}, "size: expected .*whole pixels, got"),
        ({"size": (0, 480)}, "size: expected .*whole pixels"),
        ({"size": (640, 480, 3)}, "size: expected .*whole pixels"),
        ({"response": "bright"}, "response: expected 'linear', 'srgb'"),
    ):
        refused(said, Camera, **(view | change))
