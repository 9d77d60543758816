"""The head as URDF: the same tree, limits and inertia, and the frames N and C as links."""

import xml.etree.ElementTree as ET
from math import atan2, cos, hypot, sin

import numpy as np
from numpy.typing import ArrayLike

from vergence.errors import ConfigurationError
from vergence.models.head import HeadModel
from vergence.models.joints import EYE_NAMES, JOINTS, LINKS
from vergence.models.links import T_3_N
from vergence.models.mujoco.inertia import link_inertia
from vergence.models.mujoco.model import camera_in_pan_link, rest_inertia
from vergence.models.parts import FloatArray


def to_urdf(head: HeadModel) -> str:
    """Write one head as URDF.

    The link `base` is frame 0, `<joint>_link` carries the D-H frame that the joint turns, `N`
    is the base frame of gaze and `left_camera`, `right_camera` are the optical frames (x right,
    y down, z forward). Efforts are the torques of the acceleration limits, or of reaching full
    speed within a control period where there is no limit. URDF has no place for the cameras'
    intrinsics, nor for the inertia of the rotors, which the efforts include.

    Args:
        head: one head, not a population.

    Returns:
        The XML text.

    Raises:
        ConfigurationError: the head is a population.
    """
    if head.batch_shape:
        raise ConfigurationError(
            f"URDF: expected one head, got a population of shape {head.batch_shape}"
        )
    robot = ET.Element("robot", name=head.name)
    # MuJoCo reads this and leaves the frames apart; other programs pass over it
    compiler = ET.SubElement(ET.SubElement(robot, "mujoco"), "compiler")
    compiler.set("fusestatic", "false")
    ET.SubElement(robot, "link", name="base")
    links = {0: "base"}
    inertia = rest_inertia(head)
    for frame, parent, name in LINKS:
        if name:
            links[frame] = f"{name}_link"
            _add_link(robot, head, name)
            joint = _add_joint(robot, name, links[parent], links[frame], "revolute")
            _add_origin(joint, np.matmul(*head.links.transforms(frame)))
            _add_limits(joint, head, JOINTS.index(name), inertia)
    fixed = {"N": (links[3], T_3_N)}
    for eye, name in enumerate(EYE_NAMES):
        fixed[f"{name}_camera"] = (links[5 + 3 * eye], camera_in_pan_link(head, eye))
    for name, (parent_link, pose) in fixed.items():
        ET.SubElement(robot, "link", name=name)
        _add_origin(_add_joint(robot, f"{name}_fixed", parent_link, name, "fixed"), pose)
    ET.indent(robot)
    return ET.tostring(robot, encoding="unicode", xml_declaration=True) + "\n"


def roll_pitch_yaw(rotation: FloatArray) -> tuple[float, float, float]:
    """URDF's angles of a rotation, `RotZ(yaw) RotY(pitch) RotX(roll)`, also at pitch +-pi/2.

    The yaw comes first and the roll is taken from what remains, so that where only their sum
    or difference is determined the two still make the same rotation.
    """
    r = rotation
    yaw = atan2(r[1, 0], r[0, 0]) if hypot(r[0, 0], r[1, 0]) > 1e-9 else 0.0
    c, s = cos(yaw), sin(yaw)
    pitch = atan2(-r[2, 0], c * r[0, 0] + s * r[1, 0])
    roll = atan2(s * r[0, 2] - c * r[1, 2], c * r[1, 1] - s * r[0, 1])
    return roll, pitch, yaw


def _add_link(robot: ET.Element, head: HeadModel, name: str) -> None:
    mass, centre, moments, edges = link_inertia(head, name)
    link = ET.SubElement(robot, "link", name=f"{name}_link")
    inertial = ET.SubElement(link, "inertial")
    ET.SubElement(inertial, "origin", xyz=_text(centre))
    ET.SubElement(inertial, "mass", value=_text(mass))
    tensor = dict.fromkeys(("ixy", "ixz", "iyz"), "0")
    tensor |= {key: _text(value) for key, value in zip(("ixx", "iyy", "izz"), moments, strict=True)}
    ET.SubElement(inertial, "inertia", tensor)
    visual = ET.SubElement(link, "visual")
    ET.SubElement(visual, "origin", xyz=_text(centre))
    ET.SubElement(ET.SubElement(visual, "geometry"), "box", size=_text(edges))


def _add_joint(robot: ET.Element, name: str, parent: str, child: str, kind: str) -> ET.Element:
    joint = ET.SubElement(robot, "joint", name=name, type=kind)
    ET.SubElement(joint, "parent", link=parent)
    ET.SubElement(joint, "child", link=child)
    return joint


def _add_origin(joint: ET.Element, pose: FloatArray) -> None:
    angles = roll_pitch_yaw(pose[:3, :3])
    ET.SubElement(joint, "origin", xyz=_text(pose[:3, 3]), rpy=_text(angles))


def _add_limits(joint: ET.Element, head: HeadModel, index: int, inertia: FloatArray) -> None:
    limits = head.limits
    speed, acceleration = limits.velocity[index], limits.acceleration[index]
    if not np.isfinite(acceleration):
        acceleration = speed * head.timing.control_rate_hz
    ET.SubElement(joint, "axis", xyz="0 0 1")
    ET.SubElement(
        joint,
        "limit",
        lower=_text(limits.lower[index]),
        upper=_text(limits.upper[index]),
        velocity=_text(speed),
        effort=_text(inertia[index] * acceleration),
    )


def _text(values: ArrayLike) -> str:
    # 15 digits are what a float64 keeps of any decimal, so that 0.0448 stays 0.0448
    exact = np.atleast_1d(values)
    rounded = np.where(np.abs(exact) < 1e-15, 0.0, exact)
    return " ".join(f"{value:.15g}" for value in rounded)
