"""A head as files of a robot description: MJCF and URDF."""

import re
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from math import atan2, cos, hypot, sin
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike

from vergence.errors import ConfigurationError, UnknownNameError
from vergence.models.geometry import chain_end
from vergence.models.head import HeadModel
from vergence.models.mujoco import mujoco
from vergence.models.mujoco.bodies import (
    JointCoupling,
    body_name,
    coupled_joint_equations,
    couplings_of,
    link_inertia,
    load_inertias,
)
from vergence.models.mujoco.look import (
    Board,
    add_observer_cameras,
    add_scenery,
    add_target,
    surroundings_of,
)
from vergence.models.mujoco.model import head_spec
from vergence.models.parts import EYE_NAMES, FloatArray


def to_urdf(head: HeadModel) -> str:
    """Write one head as URDF.

    The link `base` is frame 0. The z axis of a link `<joint>_link` is the axis of its joint. `N` is
    the base frame of gaze, and `left_camera` and `right_camera` are the optical frames (x right, y
    down, z forward). Efforts are the torques at the acceleration limits; without a limit, the
    torque that reaches full speed within a control period. URDF cannot hold the cameras'
    intrinsics, nor the inertia of the rotors, which the efforts include.

    A joint that follows one other joint has a `mimic` element. URDF cannot describe actuators that
    turn several joints, as a version and a vergence do; comments state their equations.

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
    # MuJoCo reads this and keeps the fixed frames as bodies; other programs ignore it
    compiler = ET.SubElement(ET.SubElement(robot, "mujoco"), "compiler")
    compiler.set("fusestatic", "false")
    ET.SubElement(robot, "link", name="base")
    couplings = {coupling.joint: coupling for coupling in couplings_of(head)}
    for sum_of_several in coupled_joint_equations(head):
        robot.append(ET.Comment(f" {_comment(sum_of_several)} "))
    bodies, loads = head.links.bodies(), load_inertias(head)
    links = {-1: "base"} | {place: body_name(body.name) for place, body in enumerate(bodies)}
    for place, body in enumerate(bodies):
        _add_link(robot, head, body.name)
        joint = _add_joint(robot, body.name, links[body.parent], links[place], "revolute")
        _add_origin(joint, body.pose)
        _add_limits(joint, head, body.joints[0], loads.joint_loads)
        if body.name in couplings:
            _add_coupling(joint, couplings[body.name])
    fixed = {"N": (links[chain_end(bodies, None)], head.links.frame_n_pose())}
    for eye, name in enumerate(EYE_NAMES):
        parent = links[chain_end(bodies, eye)]
        fixed[f"{name}_camera"] = (parent, head.camera_in_last_link(eye))
    for name, (parent, pose) in fixed.items():
        ET.SubElement(robot, "link", name=name)
        _add_origin(_add_joint(robot, f"{name}_fixed", parent, name, "fixed"), pose)
    ET.indent(robot)
    return ET.tostring(robot, encoding="unicode", xml_declaration=True) + "\n"


def roll_pitch_yaw(rotation: FloatArray) -> tuple[float, float, float]:
    """URDF's angles of a rotation, `RotZ(yaw) RotY(pitch) RotX(roll)`, also at pitch +-pi/2.

    The yaw is computed first and the roll from the remaining rotation. If only their sum or
    difference is determined, the two still give the same rotation.
    """
    r = rotation
    yaw = atan2(r[1, 0], r[0, 0]) if hypot(r[0, 0], r[1, 0]) > 1e-9 else 0.0
    c, s = cos(yaw), sin(yaw)
    pitch = atan2(-r[2, 0], c * r[0, 0] + s * r[1, 0])
    roll = atan2(s * r[0, 2] - c * r[1, 2], c * r[1, 1] - s * r[0, 1])
    return roll, pitch, yaw


def _add_link(robot: ET.Element, head: HeadModel, name: str) -> None:
    mass, centre, moments, edges = link_inertia(head, name)
    link = ET.SubElement(robot, "link", name=body_name(name))
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


def _add_coupling(joint: ET.Element, coupling: JointCoupling) -> None:
    if len(coupling.follows) == 1:
        ((other, factor),) = coupling.follows
        ET.SubElement(
            joint, "mimic", joint=other, multiplier=_text(factor), offset=_text(coupling.offset)
        )
        return
    terms = [f"{factor:+.15g} {other}" for other, factor in coupling.follows]
    followed = " ".join([f"{coupling.offset:.15g}", *terms])
    joint.append(ET.Comment(f" {_comment(f'{coupling.joint} = {followed}')} "))


def _comment(text: str) -> str:
    """Make a text valid inside an XML comment."""
    return text.replace("--", "- -").removesuffix("-")


def _text(values: ArrayLike) -> str:
    # a float64 keeps 15 digits of any decimal, so 0.0448 stays 0.0448
    exact = np.atleast_1d(values)
    rounded = np.where(np.abs(exact) < 1e-15, 0.0, exact)
    return " ".join(f"{value:.15g}" for value in rounded)


FORMATS = ("mjcf", "urdf")
"""Formats of `export_files`."""

_SCENE = "scene"


def export_files(
    head: HeadModel, format: str, targets: Mapping[str, Board] = MappingProxyType({})
) -> dict[str, bytes]:
    """Make the files of a head in one format, to be written into a folder.

    Args:
        head: one head, not a population.
        format: `mjcf` for `NAME.xml` (the head alone), `scene.xml` (which includes it and adds
            light, floor, the targets and the fixed pair) and the targets' textures, or `urdf` for
            `NAME.urdf`. NAME is the name of the head, see `file_stem`.
        targets: boards in the scene, see `build_spec`.

    Returns:
        File names, relative to the folder, with their contents.

    Raises:
        UnknownNameError: there is no such format.
        ConfigurationError: the head is a population, or has no lag (MJCF).
    """
    stem = file_stem(head)
    if format == "urdf":
        return {f"{stem}.urdf": to_urdf(head).encode()}
    if format != "mjcf":
        raise UnknownNameError("export format", format, list(FORMATS))
    scene = mujoco.MjSpec()
    scene.modelname = f"{head.name} scene"
    buffer = scene.visual.global_
    buffer.offwidth, buffer.offheight = head.cameras.size.max(axis=0).tolist()
    around = surroundings_of(head)
    add_scenery(scene, around)
    for name, board in targets.items():
        add_target(scene, name, board, around)
    add_observer_cameras(scene, around)
    root = ET.fromstring(_xml(scene))
    root.insert(0, ET.Element("include", file=f"{stem}.xml"))
    # the head's file sets these elements for both files
    for element in [*root.findall("compiler"), *root.findall("option")]:
        root.remove(element)
    ET.indent(root)
    files = {
        f"{stem}.xml": _xml(head_spec(head, gravity=True)).encode(),
        f"{_SCENE}.xml": (ET.tostring(root, encoding="unicode") + "\n").encode(),
    }
    return files | {name: bytes(data) for name, data in scene.assets.items()}


def file_stem(head: HeadModel) -> str:
    """A head's name for files: letters, digits, `.`, `_` and `-`, and never `scene`."""
    stem = re.sub(r"[^A-Za-z0-9._-]+", "-", head.name).strip(".-") or "head"
    return f"{stem}-head" if stem.lower() == _SCENE else stem


def _xml(spec: mujoco.MjSpec) -> str:
    spec.compile()
    return str(spec.to_xml())
