"""What no head may be: eyes that cannot triangulate or servo at rest."""

from typing import Final

import numpy as np

from vergence.errors import HeadFileError
from vergence.models.actuation import Actuation
from vergence.models.head import HeadModel
from vergence.models.parts import EYE_NAMES, EYES, FloatArray

_LEAST_BASELINE_M: Final = 1e-3
"""Smallest distance between the cameras (chosen: far below any real head)."""
_LEAST_CONDITION: Final = 0.05
"""Smallest determinant, or singular value, of an image Jacobian in focal lengths per radian, below
which an actuator hardly moves the images (chosen: more would refuse usable heads)."""
_TEST_POINT_DISTANCE_M: Final = 100.0
"""Distance of the point ahead; eye translation is negligible there (chosen)."""
_ANGLE_STEP_RAD: Final = 1e-5
"""Step of central differences; keeps derivatives exact to ten digits, rad (numerical)."""


def refuse_unusable_head(head: HeadModel) -> None:
    """Refuse a head that cannot triangulate or servo at rest."""
    for name, lower, upper in zip(
        head.joints[EYES], head.limits.lower[EYES], head.limits.upper[EYES], strict=True
    ):
        if name and not (lower <= 0.5 * np.pi and upper >= -0.5 * np.pi):
            raise HeadFileError(
                f"limits of {name}",
                [float(lower), float(upper)],
                "a range that comes within 1.57 rad of zero, where the eyes look ahead: angles are "
                "counted from there (turn the joint's frame by rpy_rad, and its limits with it)",
            )
    poses = head.camera_poses(head.rest())
    across = poses[1, :3, 3] - poses[0, :3, 3]
    baseline = float(np.linalg.norm(across))
    if not baseline > _LEAST_BASELINE_M:
        raise HeadFileError("eyes", f"a baseline of {baseline:.3g} m", "a baseline above 1 mm")
    # the x axes of the images define which way is right
    right, down = (poses[:, :3, axis].sum(axis=0) @ across for axis in (0, 1))
    if right < 0.0 and abs(right) > abs(down):
        raise HeadFileError(
            "eyes",
            f"a left camera {1e3 * baseline:.1f} mm on the right of the right one",
            "the left camera on the left, as the images have it (are left and right exchanged, or "
            "both cameras turned by 180 degrees, or do they look back with all joints at zero?)",
        )
    if head.actuation.count:
        _refuse_still_images(_image_jacobians(head, poses), head.actuation)


def _refuse_still_images(own: FloatArray, actuation: Actuation) -> None:
    """Refuse actuators that at rest do not each move the images in a way of its own."""
    names = actuation.names
    if actuation.direct:
        for eye, name in enumerate(EYE_NAMES):
            condition = float(np.abs(np.linalg.det(own[eye][:, 2 * eye : 2 * eye + 2])))
            if not condition > _LEAST_CONDITION:
                first, second = names[2 * eye : 2 * eye + 2]
                raise HeadFileError(
                    f"joints of the {name} eye",
                    f"an image Jacobian with determinant {condition:.3g} (by the focal lengths)",
                    f"{first} and {second} to move the image along two directions at rest, above "
                    f"{_LEAST_CONDITION} (does an axis point along the optical axis?)",
                )
        return
    _left, values, ways = np.linalg.svd(own.reshape(4, len(names)))
    if not values[-1] > _LEAST_CONDITION:
        raise HeadFileError(
            f"joints moved by {names[int(np.argmax(np.abs(ways[-1])))]}",
            f"image Jacobians with a least singular value of {values[-1]:.3g} (by the focal "
            "lengths)",
            f"{', '.join(names)} each to move the images in a way of its own at rest, above "
            f"{_LEAST_CONDITION} (does an axis point along the optical axis?)",
        )


def _image_jacobians(head: HeadModel, poses: FloatArray) -> FloatArray:
    """(2, 2, m) Jacobians of a far point ahead, by eye, image axis, actuator; focal lengths/rad."""
    count = head.actuation.count
    # central differences, since compiling `image_jacobian` would add a second to the first call
    turns = _ANGLE_STEP_RAD * np.array([[[1.0]], [[-1.0]]]) * np.eye(7)[3 : 3 + count]
    turned = head.actuation.joints_of(head.actuation.actuators_of(head.rest()) + turns)
    # far away, so that an eye that translates without turning hardly moves its image
    ahead = poses[:, :3, 3] + _TEST_POINT_DISTANCE_M * poses[:, :3, 2]
    own = np.empty((2, 2, count))
    for eye in range(2):
        plus, minus = head.project(turned, ahead[eye], distorted=False)[..., eye, :]
        own[eye] = ((plus - minus) / (2.0 * _ANGLE_STEP_RAD * head.cameras.focal[eye])).T
    return own
