"""The lens, there and back."""

import numpy as np
import pytest

from vergence.errors import ConfigurationError
from vergence.vision import EyeCamera
from vergence.vision.optics import ray_table


def test_rays_undo_projection_over_the_whole_frame(lens: EyeCamera) -> None:
    u, v = np.meshgrid(np.linspace(-8, 648, 40), np.linspace(-8, 488, 30))
    pixels = np.stack([u.ravel(), v.ravel()], axis=-1)
    rays = lens.rays(pixels)
    again = lens.project(np.column_stack([rays, np.ones(len(rays))]))
    assert np.abs(again - pixels).max() < 1e-4


def test_pinhole_agrees_with_its_matrix(pinhole: EyeCamera) -> None:
    point = np.array([[0.1, -0.2, 1.3]])
    u, v, w = pinhole.matrix @ point[0]
    assert pinhole.project(point)[0] == pytest.approx([u / w, v / w])
    assert pinhole.inverse_matrix @ pinhole.matrix == pytest.approx(np.eye(3))


def test_ray_table_holds_the_rays_of_its_samples(lens: EyeCamera) -> None:
    table = ray_table(lens, 2, 3)
    assert table.shape == ((480 + 6) * 2, (640 + 6) * 2, 2)
    row, column = 37, 801
    pixel = [[(column + 0.5) / 2 - 0.5 - 3, (row + 0.5) / 2 - 0.5 - 3]]
    assert table[row, column] == pytest.approx(lens.rays(pixel)[0], abs=1e-6)


def test_camera_of_the_wrong_shape_is_refused() -> None:
    with pytest.raises(ConfigurationError, match="distortion"):
        EyeCamera(
            width=4,
            height=4,
            focal_px=(1, 1),
            principal_px=(0, 0),
            distortion=(0.1, 0.2),  # type: ignore[arg-type]
        )
    with pytest.raises(ConfigurationError, match="positive"):
        EyeCamera(width=4, height=4, focal_px=(-1, 1), principal_px=(0, 0))
