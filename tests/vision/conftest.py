"""The eyes and the rendering that the tests of vision share."""

import pytest

from vergence.models.camera import Lens, camera_matrix
from vergence.models.parts import Rendering
from vergence.vision import Camera


@pytest.fixture
def pinhole() -> Camera:
    return Camera(size=(1040, 860), matrix=camera_matrix((619.71, 619.71), (520.5, 430.5)))


@pytest.fixture
def lens() -> Camera:
    return Camera(
        size=(640, 480), matrix=camera_matrix((521.66, 521.83), (362.94, 222.53)),
        lens=Lens("brown-conrady", (-0.0437, 0.1425, 0.0005, -0.0012, 0.0)),
    )  # fmt: skip


@pytest.fixture
def rendering() -> Rendering:
    return Rendering(
        blur_px=0.5, noise_grey=2.0, supersampling=2, black_grey=40.0, white_grey=210.0,
        background_grey=120.0,
    )  # fmt: skip
