"""Links of a head as bodies of a MuJoCo specification, with their joints and the cameras."""

from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from vergence.models.head import HeadModel
from vergence.models.joints import EYE_NAMES
from vergence.models.links import chain_end, rot_z
from vergence.models.mujoco.inertia import link_inertia
from vergence.models.mujoco.library import mujoco
from vergence.models.parts import FloatArray

_FROM_OPTICAL: Final = np.diag([1.0, -1.0, -1.0, 1.0])
"""Pose of MuJoCo's camera frame, which looks along -z with y up, in C: a turn by 180 degrees about
x (physical: MuJoCo's convention)."""
_PIXEL_M: Final = 3e-6
"""Edge of a sensor's pixel, m; it scales MuJoCo's focal lengths and cancels in the image (chosen:
typical of small cameras)."""

Bodies = Mapping[int, Any]
"""Bodies of a specification by their index in `Links.bodies`; -1 for the world."""


def add_bodies(
    spec: mujoco.MjSpec, head: HeadModel, welded_angles: Mapping[str, float], armature: FloatArray
) -> Bodies:
    """Add a body with its mass for each joint, and the site `N`.

    The joints are in the order of their first indices in an array of all seven.

    Args:
        spec: the specification to extend; its time step is set.
        head: one head.
        welded_angles: rigid joints by name, with their angles, rad.
        armature: (7,) inertia of the joints' rotors, kg m^2.

    Returns:
        The bodies.
    """
    bodies: dict[int, Any] = {-1: spec.worldbody}
    links = head.links.bodies()
    for place in sorted(range(len(links)), key=lambda i: links[i].joints[0]):
        link = links[place]
        pose = link.pose
        if link.name in welded_angles:
            pose = pose @ rot_z(np.array(welded_angles[link.name]))
        body = bodies[link.parent].add_body(
            name=body_name(link.name), gravcomp=1.0, **pos_and_quat(pose)
        )
        bodies[place] = body
        body.mass, body.ipos, body.inertia, _edges = link_inertia(head, link.name)
        body.explicitinertial = True
        if link.name not in welded_angles:
            _add_joint(body, link.name, link.joints[0], head, armature, spec.option.timestep)
    bodies[chain_end(links, None)].add_site(
        name="N", group=4, size=[0.002] * 3, **pos_and_quat(head.links.frame_n_pose())
    )
    return bodies


def body_name(joint: str) -> str:
    """Name of the body that a joint carries."""
    return f"{joint}_link"


def _add_joint(
    body: Any, name: str, place: int, head: HeadModel, armature: FloatArray, timestep_s: float
) -> None:
    body.add_joint(
        name=name,
        type=mujoco.mjtJoint.mjJNT_HINGE,
        axis=[0.0, 0.0, 1.0],
        limited=mujoco.mjtLimited.mjLIMITED_TRUE,
        range=[head.limits.lower[place], head.limits.upper[place]],
        armature=armature[place],
        solref_limit=stiff_solref(timestep_s),
    )


def stiff_solref(timestep_s: float) -> list[float]:
    """`solref` of a limit or an equality constraint, as stiff as the solver allows."""
    return [2.0 * timestep_s, 1.0]  # the least time constant is two time steps


def add_cameras(spec: mujoco.MjSpec, head: HeadModel, bodies: Bodies) -> None:
    """Add the cameras `left` and `right` to the last bodies of both eyes."""
    links = head.links.bodies()
    for eye, (name, size) in enumerate(zip(EYE_NAMES, head.cameras.size, strict=True)):
        bodies[chain_end(links, eye)].add_camera(
            name=name,
            resolution=size,
            sensor_size=_PIXEL_M * size,
            focal_pixel=head.cameras.focal[eye],
            principal_pixel=mujoco_principal(head)[eye],
            **pos_and_quat(head.camera_in_last_link(eye) @ _FROM_OPTICAL),
        )
    buffer = spec.visual.global_
    buffer.offwidth, buffer.offheight = head.cameras.size.max(axis=0).tolist()


def mujoco_principal(head: HeadModel) -> FloatArray:
    """(2, 2) `principalpixel` of both cameras, in pixels.

    MuJoCo counts from the image's centre, with right and down negative. OpenCV's (0, 0) is the
    centre of the upper left pixel, hence `W / 2 - (u_0 + 1/2)`.
    """
    return np.asarray(head.cameras.size / 2.0 - (head.cameras.principal + 0.5))


def pos_and_quat(pose: FloatArray) -> dict[str, FloatArray]:
    """Convert a pose (4, 4) in the parent to MuJoCo's attributes `pos` and `quat`."""
    quat = np.empty(4)
    mujoco.mju_mat2Quat(quat, pose[:3, :3].ravel())
    return {"pos": pose[:3, 3], "quat": np.copysign(1.0, quat[0]) * quat}
