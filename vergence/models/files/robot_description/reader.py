"""A URDF or MJCF as a mechanism, by MuJoCo's own parser; meshes are not needed."""

import os
import xml.etree.ElementTree as ET
from dataclasses import replace
from typing import Any, Final

import mujoco
import numpy as np

from vergence.errors import HeadFileError
from vergence.models.files.robot_description.mechanism import (
    Frame,
    Joint,
    JointKind,
    Mechanism,
    SpecCamera,
    Tie,
)
from vergence.models.files.robot_description.robot_xml import (
    EXPECTED,
    Limits,
    Written,
    check_names,
    parse_xml,
    urdf_ties,
    urdf_written,
)
from vergence.models.parts import FloatArray

_KINDS: Final[dict[Any, JointKind]] = {
    mujoco.mjtJoint.mjJNT_HINGE: "hinge",
    mujoco.mjtJoint.mjJNT_SLIDE: "slide",
    mujoco.mjtJoint.mjJNT_BALL: "ball",
    mujoco.mjtJoint.mjJNT_FREE: "free",
}


def read_mechanism(path: str | os.PathLike[str]) -> Mechanism:
    """Read the frames and joints of a URDF or MJCF.

    MuJoCo parses the file, and nothing is compiled: meshes may be missing, fixed frames stay.
    What its parser drops or changes of a URDF, such as speed limits, comes from the XML.

    Args:
        path: the file.

    Returns:
        The mechanism.

    Raises:
        HeadFileError: it cannot be read, or is neither.
    """
    name = os.fspath(path)
    root = parse_xml(name)
    if root.tag == "robot":
        check_names(name, root)
    # without a receiver MuJoCo would write its warnings to a file in the working directory; those
    # that matter here are found again by who uses the joint
    mujoco.set_mju_user_warning(lambda _: None)
    try:
        return _mechanism(mujoco.MjSpec.from_file(name), root)
    except (ValueError, mujoco.FatalError) as error:
        raise _unreadable(name, error) from error
    finally:
        mujoco.set_mju_user_warning(None)


def _mechanism(spec: Any, root: ET.Element) -> Mechanism:
    if root.tag == "robot":
        # MuJoCo puts the root link into a world of its own, which is no frame of the file
        world = "world" if any(link.get("name") == "world" for link in root.iter("link")) else ""
        return Mechanism(
            name=root.get("name", ""),
            frames=_frames(spec, world, urdf_written(root)),
            ties=urdf_ties(root),
        )
    frames = _frames(spec, "world", Written({}, {}, {}))
    return Mechanism(name=spec.modelname, frames=frames, ties=_mjcf_ties(spec))


def _unreadable(name: str, error: Exception) -> HeadFileError:
    """What MuJoCo says of a file that it cannot take."""
    reason = " ".join(str(error).split())
    return HeadFileError(name, reason, f"{EXPECTED} that MuJoCo can read")


def _mjcf_ties(spec: Any) -> dict[str, Tie]:
    """Active joint constraints: `y - y0 = a0 + a1 (x - x0)`, y0 and x0 being the references."""
    references = {joint.name: float(joint.ref) * _unit(joint) for joint in spec.joints}
    ties = {}
    for equality in spec.equalities:
        if equality.type != mujoco.mjtEq.mjEQ_JOINT or not equality.active:
            continue
        offset, factor, *higher = (float(value) for value in equality.data[:5])
        follower, master = equality.name1, equality.name2
        offset += references.get(follower, 0.0)
        if not master:
            factor = 0.0
        elif any(higher):
            factor = np.nan
        else:
            offset -= factor * references.get(master, 0.0)
        ties[follower] = Tie(follower, master, factor, offset)
    return ties


def _frames(spec: Any, world: str, written: Written) -> tuple[Frame, ...]:
    frames: list[Frame] = []
    speeds = _servo_speeds(spec)
    pending = [(spec.worldbody, -1)]
    while pending:
        body, parent = pending.pop(0)
        index = len(frames)
        name = body.name if index else world
        joints = tuple(
            _joint(spec, joint, f"{name}#{i}", written.limits, speeds)
            for i, joint in enumerate(body.joints)
        )
        if name in written.kinds:  # of a planar joint MuJoCo makes three
            whole, kind = written.kinds[name]
            joints = tuple(replace(joint, name=whole, kind=kind) for joint in joints[:1])
        pose = _placed(spec, body)
        fault = written.faults.get(name, "")
        frames.append(
            Frame(name=name, kind="body", parent=parent, pose=pose, joints=joints, fault=fault)
        )
        frames += [
            Frame(name=site.name, kind="site", parent=index, pose=_placed(spec, site))
            for site in body.sites
        ]
        frames += [
            Frame(
                name=camera.name,
                kind="camera",
                parent=index,
                pose=_placed(spec, camera),
                camera=_camera(camera),
            )
            for camera in body.cameras
        ]
        pending += [(child, index) for child in body.bodies]
    return tuple(frames)


def _joint(spec: Any, joint: Any, unnamed: str, limits: Limits, speeds: dict[str, float]) -> Joint:
    around = _frames_around(spec, joint)
    axis = around[:3, :3] @ np.array(joint.axis, dtype=np.float64)
    anchor = around @ np.append(joint.pos, 1.0)
    length = float(np.linalg.norm(axis))
    unit = _unit(joint)
    name = joint.name or unnamed
    if name in limits:
        lower, upper, velocity = limits[name]
    else:
        lower, upper = (float(value) * unit for value in joint.range)
        limited = joint.limited == mujoco.mjtLimited.mjLIMITED_TRUE or (
            joint.limited == mujoco.mjtLimited.mjLIMITED_AUTO
            and spec.compiler.autolimits
            and lower != upper
        )
        if not limited:
            lower = upper = np.nan
        velocity = speeds.get(name, np.nan)
    return Joint(
        name=name,
        kind=_KINDS[joint.type],
        anchor=anchor[:3],
        axis=axis / length if length > 0.0 else np.full(3, np.nan),
        reference=float(joint.ref) * unit,
        lower=lower,
        upper=upper,
        velocity=velocity,
    )


def _unit(joint: Any) -> float:
    """Radians, or metres, of what the file writes as 1."""
    hinge = joint.type in (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_BALL)
    return np.pi / 180.0 if hinge and joint.compiler.degree else 1.0


def _servo_speeds(spec: Any) -> dict[str, float]:
    """The speeds that velocity servos of an MJCF may be commanded."""
    speeds = {}
    for servo in spec.actuators:
        gain, bias = servo.gainprm, servo.biasprm
        if (
            servo.trntype == mujoco.mjtTrn.mjTRN_JOINT
            and servo.gaintype == mujoco.mjtGain.mjGAIN_FIXED
            and servo.biastype == mujoco.mjtBias.mjBIAS_AFFINE
            and servo.dyntype == mujoco.mjtDyn.mjDYN_NONE
            and bias[0] == bias[1] == 0.0
            and gain[0] == -bias[2] > 0.0
            and servo.gear[0] != 0.0
            and servo.ctrllimited != mujoco.mjtLimited.mjLIMITED_FALSE
            and servo.ctrlrange[0] < servo.ctrlrange[1]
        ):
            speed = min(abs(float(value)) for value in servo.ctrlrange) / abs(float(servo.gear[0]))
            speeds[servo.target] = speed
    return speeds


def _placed(spec: Any, element: Any) -> FloatArray:
    """(4, 4) an element's pose in its body or, for a body, in its parent."""
    return np.asarray(_frames_around(spec, element) @ _pose(spec, element))


def _frames_around(spec: Any, element: Any) -> FloatArray:
    """(4, 4) of the <frame> elements of an MJCF, one in another, that an element stands in."""
    pose = np.eye(4)
    frame = element.frame
    while frame is not None:
        pose = _pose(spec, frame) @ pose
        frame = frame.frame
    return pose


def _pose(spec: Any, element: Any) -> FloatArray:
    quat = np.array(element.quat, dtype=np.float64)
    if element.alt.type != mujoco.mjtOrientation.mjORIENTATION_QUAT:
        quat = np.array(
            spec.resolve_orientation(
                degree=element.compiler.degree,
                sequence=element.compiler.eulerseq,
                orientation=element.alt,
            )
        )
    pose = np.eye(4)
    pose[:3, :3] = _rotation(quat)
    pose[:3, 3] = element.pos
    return pose


def _rotation(quat: FloatArray) -> FloatArray:
    w, x, y, z = quat / np.linalg.norm(quat)
    return np.array(
        [
            [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
            [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
            [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
        ]
    )


def _decimals(values: Any) -> FloatArray:
    """What the file has of numbers that MuJoCo keeps in single precision."""
    return np.array([float(str(np.float32(value))) for value in values])


def _camera(camera: Any) -> SpecCamera:
    """A camera's image; MuJoCo's default resolution of one pixel says nothing."""
    fault = ""
    if camera.mode != mujoco.mjtCamLight.mjCAMLIGHT_FIXED:
        fault = "turns by itself after something (its mode is not fixed)"
    elif camera.proj != mujoco.mjtProjection.mjPROJ_PERSPECTIVE:
        fault = "has a projection that is not perspective"
    fovy = float(camera.fovy)
    size = np.array(camera.resolution, dtype=np.float64)
    if size.max() <= 1.0:
        return SpecCamera(size=None, focal=None, fovy_deg=fovy, principal=None, fault=fault)
    focal, offset = _decimals(camera.focal_pixel), _decimals(camera.principal_pixel)
    sensor = _decimals(camera.sensor_size)
    if sensor.min() > 0.0:
        if not focal.any():
            focal = _decimals(camera.focal_length) / sensor * size
        if not offset.any():
            offset = _decimals(camera.principal_length) / sensor * size
    known = bool(sensor.min() > 0.0 and focal.min() > 0.0)
    return SpecCamera(
        size=(int(size[0]), int(size[1])),
        focal=focal if known else None,
        fovy_deg=fovy,
        fault=fault,
        # MuJoCo counts from the image's centre towards the left and up, in edges of pixels
        principal=size / 2.0 - offset - 0.5 if known else None,
    )
