"""The eyes and the rendering that the tests of vision share."""

import pytest

from vergence.models.parts import Rendering
from vergence.vision import EyeCamera


@pytest.fixture
def pinhole() -> EyeCamera:
    return EyeCamera(width=1040, height=860, focal_px=(619.71, 619.71), principal_px=(520.5, 430.5))


@pytest.fixture
def lens() -> EyeCamera:
    return EyeCamera(
        width=640, height=480, focal_px=(521.66, 521.83), principal_px=(362.94, 222.53),
        distortion=(-0.0437, 0.1425, 0.0005, -0.0012, 0.0),
    )  # fmt: skip


@pytest.fixture
def rendering() -> Rendering:
    return Rendering(
        blur_px=0.5, noise_grey=2.0, supersampling=2, black_grey=40.0, white_grey=210.0,
        background_grey=120.0,
    )  # fmt: skip
