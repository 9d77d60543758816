"""Appearance of the head: rods from joint to joint, a skull or a bar, eyeballs, a stand."""

from typing import Any, Final

import numpy as np

from vergence.models.head import HeadModel
from vergence.models.joints import NECK
from vergence.models.links import inverse_pose
from vergence.models.mujoco.bodies import Bodies
from vergence.models.mujoco.library import mujoco
from vergence.models.mujoco.posture import EYE_RADIUS_M, RestPoses, n_and_camera_bodies, rest_poses
from vergence.models.mujoco.shapes import (
    DARK,
    LENS,
    METAL,
    SHELL,
    add_materials,
    add_segment,
    add_shape,
)
from vergence.models.parts import FloatArray

_GEOM: Final = mujoco.mjtGeom
SKULL_CENTRE_M: Final = (-0.055, 0.030, 0.001)
"""Centre of the article's skull, an ellipsoid behind the eyes, in frame 3, m (chosen: looks
only)."""
SKULL_AXES_M: Final = (0.062, 0.082, 0.074)
"""Semi-axes of that ellipsoid in frame 3, m (chosen: looks only)."""
_SKULL_BEHIND_M: Final = (0.0, -0.030, -0.080)
"""Centre of any other head's skull, from the midpoint between the cameras, in N's axes, m (chosen:
looks only)."""
_SKULL_AXES_IN_N_M: Final = (0.074, 0.082, 0.062)
"""Semi-axes of any other head's skull, along N's axes, m (chosen: looks only)."""
_MAX_SKULL_BASELINE_M: Final = 0.16
"""Largest baseline for a skull, m; the eyes of a wider head are on a bar (chosen: looks only)."""
IRIS_RADIUS_M: Final = 0.009
"""Radius of the iris in an eyeball of full size, m (chosen: looks only)."""
_MAX_CENTRED_OFFSET_M: Final = 0.004
"""Distance of a camera from its last joint's origin below which the eyeball is centred on the
joint, m (chosen: looks only)."""
_STAND_BELOW_HEAD_M: Final = 0.25
"""Length of the stand below the lowest joint, m (chosen: looks only)."""
_MIN_MOTOR_DISTANCE_M: Final = 0.05
"""Least distance of the neck's first motor from the midpoint between the cameras for it to be
drawn, m (chosen: a nearer one would hide the eyes)."""


def add_appearance(spec: mujoco.MjSpec, bodies: Bodies, head: HeadModel) -> None:
    """Add the visible shapes of a head with two eyes; they have no mass and no contacts.

    Args:
        spec: the specification to extend.
        bodies: the body of each link; -1 for the world.
        head: the head; its link lengths determine the shapes.
    """
    add_materials(spec)
    posture, links = rest_poses(head), head.links.bodies()
    skull, *ends = n_and_camera_bodies(head)
    _add_stand(bodies[-1], posture)
    for place, link in enumerate(links):
        body, size = bodies[place], posture.scale
        rod = 0.006
        if link.joints[0] < NECK.stop:
            first = link.parent == -1
            rod = 0.007 if place == skull else 0.011 if first else 0.009
            to_eyes = posture.links[place, :3, 3] - posture.cameras[:, :3, 3].mean(axis=0)
            if first and np.linalg.norm(to_eyes) > _MIN_MOTOR_DISTANCE_M * size:
                bottom, top = [0.0, 0.0, -0.03 * size], [0.0, 0.0, 0.018 * size]
                add_segment(body, DARK, bottom, top, 0.03 * size)
            elif not first and place != skull:
                add_segment(body, DARK, [0.0, 0.0, -0.025 * size], [0.0, 0.0, 0.0], 0.022 * size)
        if place == skull and posture.is_article_head:
            add_shape(body, _GEOM.mjGEOM_ELLIPSOID, SHELL, size=SKULL_AXES_M, pos=SKULL_CENTRE_M)
        for other in links:
            if other.parent == place and not (place == skull and _on_bar(posture)):
                _add_rod(body, other.pose[:3, 3], rod * size)
    if not posture.is_article_head:
        _add_face(bodies[skull], skull, posture)
    for eye, place in enumerate(ends):
        _add_eye(bodies[place], head.camera_in_last_link(eye), posture, place != skull)


def _on_bar(posture: RestPoses) -> bool:
    """True if the eyes are on a bar instead of in a skull."""
    return not posture.is_article_head and posture.baseline_m > _MAX_SKULL_BASELINE_M


def _add_stand(world: Any, posture: RestPoses) -> None:
    """Add a stand from the floor to the first joint of the neck, or to the bar of the eyes."""
    top, up = posture.stand_top, posture.upright_frame[:3, 2]
    height = up @ (top - posture.upright_frame[:3, 3]) - (posture.lowest_m - _STAND_BELOW_HEAD_M)
    add_segment(world, METAL, top - height * up, top, 0.022 * posture.scale)


def _add_face(body: Any, skull: int, posture: RestPoses) -> None:
    """Add a skull behind the eyes, or a bar that carries them, to the body that carries N."""
    frame = posture.links[skull] if skull >= 0 else np.eye(4)
    into = inverse_pose(frame)
    middle = posture.cameras[:, :3, 3].mean(axis=0)
    rotation, size = into[:3, :3] @ posture.frame_n[:3, :3], posture.scale
    if skull >= 0 and not _on_bar(posture):
        centre = middle + size * posture.frame_n[:3, :3] @ _SKULL_BEHIND_M
        quat = np.zeros(4)
        mujoco.mju_mat2Quat(quat, np.ascontiguousarray(rotation).ravel())
        add_shape(
            body,
            _GEOM.mjGEOM_ELLIPSOID,
            SHELL,
            size=size * np.array(_SKULL_AXES_IN_N_M),
            pos=into[:3, :3] @ centre + into[:3, 3],
            quat=quat,
        )
        return
    held = [into[:3, :3] @ end + into[:3, 3] for end in posture.bar_ends]
    fronts = [into[:3, :3] @ root + into[:3, 3] for root in posture.eye_roots]
    _add_rod(body, held[1], 0.009 * size, held[0])
    for back, front in zip(held, fronts, strict=True):
        _add_rod(body, front, 0.006 * size, back)
    if skull >= 0:
        _add_rod(body, 0.5 * (held[0] + held[1]), 0.009 * size)


def _add_eye(body: Any, camera: FloatArray, posture: RestPoses, moves: bool) -> None:
    """Add an eyeball around the camera, with an iris in front."""
    radius, forward = posture.eye_radius_m, camera[:3, 2]
    small = radius / EYE_RADIUS_M
    centre = camera[:3, 3]
    if moves and np.linalg.norm(centre) < _MAX_CENTRED_OFFSET_M:
        centre = np.zeros(3)
    elif moves:
        _add_rod(body, centre, 0.006 * posture.scale)
    add_shape(body, _GEOM.mjGEOM_SPHERE, SHELL, size=[radius, 0.0, 0.0], pos=centre)
    # they start behind the optical centre: OpenGL does not draw faces seen from behind
    start, front = -0.005 * small * forward, (radius + 0.001 * small) * forward
    iris = IRIS_RADIUS_M * small
    ends = [start, front, 1.05 * front]
    if centre.any():
        ends = [centre + end for end in ends]
    add_segment(body, DARK, ends[0], ends[1], iris)
    add_segment(body, LENS, ends[0], ends[2], 0.6 * iris)


def _add_rod(body: Any, end: FloatArray, radius: float, start: Any = (0.0, 0.0, 0.0)) -> None:
    """Add a rod between two points that are more than 1 mm apart."""
    if np.linalg.norm(end - np.asarray(start)) > 1e-3:
        add_segment(body, METAL, start, end, radius, _GEOM.mjGEOM_CAPSULE)
