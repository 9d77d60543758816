"""Axes of a camera's frame that point right and down in its image, and forward."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import permutations, product
from typing import Final

import numpy as np

from vergence.errors import ConfigurationError
from vergence.models.parts import FloatArray

OPTICAL_AXES: Final = "x,y,z"
"""Axes of an optical frame: x right, y down, z forward."""
MUJOCO_AXES: Final = "x,-y,-z"
"""Axes of MuJoCo's cameras, which look along -z with y up, as in OpenGL."""

_AXES: Final = {sign + name: s * np.eye(3)[i] for s, sign in ((1.0, ""), (-1.0, "-"))
                for i, name in enumerate("xyz")}  # fmt: skip
_ALIGNED_COSINE: Final = np.cos(np.deg2rad(45.0))
"""Cosine of the angle below which an axis counts as aligned with a direction (chosen)."""
_ROLL_AXIS_COSINE: Final = np.cos(np.deg2rad(25.0))
"""Cosine of the angle between optical axis and joint axis below which a joint would roll the
image (chosen: tilted mounts are accepted, wrong frames refused)."""


def rotation_of_axes(right_down_forward: str) -> FloatArray:
    """R_frame_camera, (3, 3), from the axes `right,down,forward`, such as `x,-y,-z`."""
    names = [name.strip().lower().removeprefix("+") for name in right_down_forward.split(",")]
    expected = (
        "camera-axes: expected the axes of the camera's frame that point right in the image, down "
        "in it and forward, such as x,-y,-z"
    )
    if len(names) != 3 or not set(names) <= set(_AXES) or len({n[-1] for n in names}) != 3:
        raise ConfigurationError(f"{expected}, got {right_down_forward!r}")
    rotation = np.column_stack([_AXES[name] for name in names])
    if np.linalg.det(rotation) < 0.0:
        mirrored = names[2].removeprefix("-") if names[2].startswith("-") else f"-{names[2]}"
        raise ConfigurationError(
            f"{expected}, forward being right x down, got {right_down_forward!r}, which is "
            "left-handed "
            f"({names[0]},{names[1]},{mirrored} is not)"
        )
    return np.asarray(rotation)


@dataclass(frozen=True, kw_only=True, eq=False)
class EyeAtZeroAngles:
    """A camera and its joint axes at zero, in the base's frame, to check the camera's axes."""

    name: str
    pose: FloatArray  # (4, 4) of the camera, with axes right, down, forward
    joint_axes: FloatArray  # (J, 3) of the joints that move this eye


def check_camera_axes(eyes: Sequence[EyeAtZeroAngles], up: FloatArray) -> None:
    """Refuse cameras unless, at zero, they are side by side, look ahead and are upright."""
    across = eyes[1].pose[:3, 3] - eyes[0].pose[:3, 3]
    distance = float(np.linalg.norm(across))
    if not distance > 1e-3:
        raise ConfigurationError(
            f"cameras: expected two that are more than 1 mm apart, got {eyes[0].name} and "
            f"{eyes[1].name}, {1000.0 * distance:.3g} mm apart at zero"
        )
    across = across / distance
    wrong = [(eye, why) for eye in eyes if (why := _fault(eye, across, up))]
    if not wrong:
        return
    fitting = [_fitting(eye, across, up) for eye in eyes]
    proposals = fitting[:1] if fitting[0] == fitting[1] else fitting
    text = " ".join(f"--camera-axes={triple}" for triple in proposals)
    eye, why = wrong[0]
    exchanged = (
        "; or the left and the right camera are exchanged"
        if all(e.pose[:3, 0] @ across < -_ALIGNED_COSINE for e in eyes)
        else ""
    )
    if fitting == [OPTICAL_AXES, OPTICAL_AXES]:
        raise ConfigurationError(
            f"{eye.name}: expected cameras side by side that look ahead at zero, got one whose "
            f"{why}: check which frames are the cameras (--camera-axes={OPTICAL_AXES} takes them "
            "as "
            f"they are{exchanged})"
        )
    raise ConfigurationError(
        f"{eye.name}: expected a camera frame with x right, y down and z forward, got one whose "
        f"{why}: {text} would fit ({OPTICAL_AXES} if it is right as it is{exchanged})"
    )


def _fault(eye: EyeAtZeroAngles, across: FloatArray, up: FloatArray) -> str:
    right, down, forward = eye.pose[:3, :3].T
    if right @ across < _ALIGNED_COSINE:
        return f"x is {_angle(right @ across)} from the line from the left camera to the right one"
    if abs(forward @ across) > _ALIGNED_COSINE:
        return f"z is {_angle(forward @ across)} from the line between the cameras"
    if down @ up > _ALIGNED_COSINE:
        return "y points up"
    for axis in eye.joint_axes:
        if abs(forward @ axis) > _ROLL_AXIS_COSINE:
            return "z lies along an axis that the eye turns about"
    return ""


def _angle(cosine: float) -> str:
    return f"{np.rad2deg(np.arccos(np.clip(cosine, -1.0, 1.0))):.0f} degrees"


def _fitting(eye: EyeAtZeroAngles, across: FloatArray, up: FloatArray) -> str:
    """Axes `right,down,forward` of the frame that fit best."""

    def misfit(triple: str) -> float:
        right, down, forward = (eye.pose[:3, :3] @ rotation_of_axes(triple)).T
        rolled = max((abs(float(forward @ axis)) for axis in eye.joint_axes), default=0.0)
        return float(-2.0 * (right @ across) + down @ up + 1.5 * rolled)

    return min(_RIGHT_HANDED_AXES, key=misfit)


_RIGHT_HANDED_AXES: Final = tuple(
    triple
    for names in permutations("xyz")
    for signs in product(("", "-"), repeat=3)
    if np.linalg.det(
        np.column_stack([_AXES[s + n] for s, n in zip(signs, names, strict=True)])
    ) > 0.0
    for triple in [",".join(s + n for s, n in zip(signs, names, strict=True))]
)  # fmt: skip
