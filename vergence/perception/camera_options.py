"""The camera of an image, from command-line options: a head's eye, or one of a calibration."""

from pathlib import Path

from vergence.errors import ConfigurationError
from vergence.models.head_file import load_head
from vergence.models.parts import EYE_NAMES
from vergence.models.stereo_files import read_intrinsics
from vergence.vision import Camera


def load_camera(
    head: str | None,
    calibration: Path | None,
    eye: str | None,
    *,
    size: tuple[int, int] | None = None,
    lens: str | None = None,
) -> tuple[Camera | None, tuple[str, ...]]:
    """Load the camera that options name, None if none, and phrases on its doubtful values."""
    if head is not None and calibration is not None:
        raise ConfigurationError("camera: expected either --head or --camera, got both")
    for option, given in (("size", size), ("lens", lens)):
        if given is not None and calibration is None:
            raise ConfigurationError(f"{option}: expected --camera beside it, got none")
    if head is not None:
        if eye is None:
            raise ConfigurationError("eye: expected left or right beside --head, got none")
        return Camera.of(load_head(head), EYE_NAMES.index(eye)), ()
    if calibration is None:
        if eye is not None:
            raise ConfigurationError("eye: expected --head or --camera beside it, got neither")
        return None, ()
    if calibration.suffix.lower() == ".toml":
        raise ConfigurationError(
            f"camera: expected a calibration of OpenCV, ROS or kalibr, got {calibration} (a head "
            "file is given as --head, with --eye left or right)"
        )
    both = read_intrinsics([calibration], size=size, lens=lens)
    if eye is None and both.left is not both.right:
        raise ConfigurationError(
            f"eye: expected left or right, as {calibration} is of two cameras, got none"
        )
    return both.right if eye == "right" else both.left, both.guesses
