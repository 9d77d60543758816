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
from vergence.models.mujoco.look import Board, add_observer_cameras, add_scenery, add_target
from vergence.models.mujoco.model import (
    build_spec,
    couplings_of,
    eye_joints,
    joint_index_by_name,
    link_inertias,
    load_inertias,
)
from vergence.models.parts import EYE_NAMES, FloatArray
from vergence.models.posture import rest_poses

FORMATS = ("mjcf", "urdf")
"""Formats of `export_files`."""
_SCENE = "scene"


def export_files(
    head: HeadModel, format: str, targets: Mapping[str, Board] = MappingProxyType({})
) -> dict[str, bytes]:
    """Contents of the files of one head by name, relative to their folder.

    `mjcf` makes `NAME.xml` (the head alone), `scene.xml` (which includes it and adds light, floor,
    targets by the names of their mocap bodies, and the fixed pair) and textures; `urdf` NAME.urdf.
    """
    stem = re.sub(r"[^A-Za-z0-9._-]+", "-", head.name).strip(".-") or "head"
    stem = f"{stem}-head" if stem.lower() == _SCENE else stem
    if format == "urdf":
        return {f"{stem}.urdf": to_urdf(head).encode()}
    if format != "mjcf":
        raise UnknownNameError("export format", format, list(FORMATS))
    whole = build_spec(head, gravity=True, scenery=False)
    scene, posture = mujoco.MjSpec(), rest_poses(head)
    scene.modelname = f"{head.name} scene"
    buffer, size = scene.visual.global_, head.cameras.size.max(axis=0)
    buffer.offwidth, buffer.offheight = np.maximum(size, (1280, 720)).tolist()  # for both pairs
    add_scenery(scene, posture)
    for name, board in targets.items():
        add_target(scene, name, board, posture)
    add_observer_cameras(scene, posture)
    root = ET.fromstring(_xml(scene))
    root.insert(0, ET.Element("include", file=f"{stem}.xml"))
    # the head's file sets these elements for both files
    for element in [*root.findall("compiler"), *root.findall("option")]:
        root.remove(element)
    ET.indent(root)
    text = ET.tostring(root, encoding="unicode") + "\n"
    files = {f"{stem}.xml": _xml(whole).encode(), f"{_SCENE}.xml": text.encode()}
    return files | {name: bytes(data) for name, data in scene.assets.items()}


def _xml(spec: mujoco.MjSpec) -> str:
    spec.compile()
    return str(spec.to_xml())


def to_urdf(head: HeadModel) -> str:
    """Write one head as URDF; raise a `ConfigurationError` for a population.

    The link `base` is frame 0. The z axis of a link `<joint>_link` is the axis of its joint. `N` is
    the base frame of gaze, and `left_camera` and `right_camera` are the optical frames (x right, y
    down, z forward). Efforts are the torques at the acceleration limits; without a limit, the
    torque that reaches full speed within a control period. URDF cannot hold the cameras'
    intrinsics, nor the inertia of the rotors, which the efforts include.

    A joint that follows one other joint has a `mimic` element. URDF cannot describe actuators that
    turn several joints, as a version and a vergence do; comments state their equations.
    """
    if head.batch_shape:
        raise ConfigurationError(
            f"URDF: expected one head, got a population of shape {head.batch_shape}"
        )
    robot = ET.Element("robot", name=head.name)
    # MuJoCo reads this and keeps the fixed frames as bodies; other programs ignore it
    ET.SubElement(ET.SubElement(robot, "mujoco"), "compiler", fusestatic="false")
    ET.SubElement(robot, "link", name="base")
    for name, row, start in zip(*eye_joints(head), strict=True):
        if np.count_nonzero(row) > 1:
            terms = [f"{f:+g} {a}" for a, f in zip(head.actuation.names, row, strict=True) if f]
            terms += [f"{start:+g}"] if start else []
            _add_comment(robot, f"{name} = {' '.join(terms).removeprefix('+')}")
    bodies, limits = head.links.bodies(), head.limits
    loads = dict(zip(joint_index_by_name(head), load_inertias(head).joint_loads, strict=True))
    couplings = {joint: (follows, offset) for joint, follows, offset in couplings_of(head)}
    links = {-1: "base"} | {place: f"{body.name}_link" for place, body in enumerate(bodies)}
    for place, (mass, centre, moments, edges) in enumerate(link_inertias(head)):
        body, index = bodies[place], bodies[place].joints[0]
        link = ET.SubElement(robot, "link", name=links[place])
        inertial, visual = (ET.SubElement(link, name) for name in ("inertial", "visual"))
        _add(inertial, "origin", xyz=centre)
        _add(inertial, "mass", value=mass)
        ixx, iyy, izz = moments
        _add(inertial, "inertia", ixy=0, ixz=0, iyz=0, ixx=ixx, iyy=iyy, izz=izz)
        _add(visual, "origin", xyz=centre)
        _add(ET.SubElement(visual, "geometry"), "box", size=edges)
        parent = links[body.parent]
        joint = _add_joint(robot, body.name, "revolute", parent, links[place], body.pose)
        speed, acceleration = limits.velocity[index], limits.acceleration[index]
        if not np.isfinite(acceleration):
            acceleration = speed * head.timing.control_rate_hz
        _add(joint, "axis", xyz=(0, 0, 1))
        ends = {"lower": limits.lower[index], "upper": limits.upper[index]}
        _add(joint, "limit", **ends, velocity=speed, effort=loads[body.name] * acceleration)
        if body.name in couplings:
            follows, offset = couplings[body.name]
            if len(follows) == 1:
                ((other, factor),) = follows
                _add(joint, "mimic", joint=other, multiplier=factor, offset=offset)
            else:
                terms = [f"{factor:+.15g} {other}" for other, factor in follows]
                _add_comment(joint, f"{body.name} = {' '.join([f'{offset:.15g}', *terms])}")
    fixed = {"N": (chain_end(bodies, None), head.links.frame)}
    for eye, name in enumerate(EYE_NAMES):
        fixed[f"{name}_camera"] = chain_end(bodies, eye), head.camera_in_last_link(eye)
    for name, (place, pose) in fixed.items():
        ET.SubElement(robot, "link", name=name)
        _add_joint(robot, f"{name}_fixed", "fixed", links[place], name, pose)
    ET.indent(robot)
    return ET.tostring(robot, encoding="unicode", xml_declaration=True) + "\n"


def _add_joint(
    robot: ET.Element, name: str, kind: str, parent: str, child: str, pose: FloatArray
) -> ET.Element:
    joint = ET.SubElement(robot, "joint", name=name, type=kind)
    _add(joint, "parent", link=parent)
    _add(joint, "child", link=child)
    _add(joint, "origin", xyz=pose[:3, 3], rpy=roll_pitch_yaw(pose[:3, :3]))
    return joint


def _add(parent: ET.Element, tag: str, **values: ArrayLike) -> None:
    """Add an element whose attributes are numbers, or a name."""
    ET.SubElement(parent, tag, {key: _text(value) for key, value in values.items()})


def _text(value: ArrayLike) -> str:
    if isinstance(value, str):
        return value
    # a float64 keeps 15 digits of any decimal, so 0.0448 stays 0.0448
    exact = np.atleast_1d(value)
    return " ".join(f"{number:.15g}" for number in np.where(np.abs(exact) < 1e-15, 0.0, exact))


def _add_comment(parent: ET.Element, text: str) -> None:
    valid = text.replace("--", "- -").removesuffix("-")  # inside a comment
    parent.append(ET.Comment(f" {valid} "))


def roll_pitch_yaw(r: FloatArray) -> tuple[float, float, float]:
    """URDF's angles of a rotation, `RotZ(yaw) RotY(pitch) RotX(roll)`, also at pitch +-pi/2.

    The yaw is computed first and the roll from the remaining rotation. If only their sum or
    difference is determined, the two still give the same rotation.
    """
    yaw = atan2(r[1, 0], r[0, 0]) if hypot(r[0, 0], r[1, 0]) > 1e-9 else 0.0
    c, s = cos(yaw), sin(yaw)
    pitch = atan2(-r[2, 0], c * r[0, 0] + s * r[1, 0])
    roll = atan2(s * r[0, 2] - c * r[1, 2], c * r[1, 1] - s * r[0, 1])
    return roll, pitch, yaw
