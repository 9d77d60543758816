"""Read a URDF or MJCF as a mechanism with MuJoCo's parser; meshes are not needed."""

import os
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Final

import numpy as np

from vergence.errors import HeadFileError
from vergence.models.files.robot_description.mechanism import (
    Frame,
    Joint,
    JointKind,
    LeftOut,
    Mechanism,
    MimicJoint,
    MjcfCamera,
)
from vergence.models.files.robot_description.robot_xml import (
    EXPECTED,
    Limits,
    UrdfExtras,
    check_urdf_names,
    parse_xml,
    urdf_extras,
    urdf_mimic_joints,
)
from vergence.models.mujoco.library import mujoco
from vergence.models.parts import FloatArray

_KINDS: Final[dict[Any, JointKind]] = {
    mujoco.mjtJoint.mjJNT_HINGE: "hinge",
    mujoco.mjtJoint.mjJNT_SLIDE: "slide",
    mujoco.mjtJoint.mjJNT_BALL: "ball",
    mujoco.mjtJoint.mjJNT_FREE: "free",
}
_LOOPS: Final = (mujoco.mjtEq.mjEQ_CONNECT, mujoco.mjtEq.mjEQ_WELD)


def read_mechanism(path: str | os.PathLike[str]) -> Mechanism:
    """Read the frames and joints of a URDF or MJCF, uncompiled; from the XML what MuJoCo drops."""
    name = os.fspath(path)
    root = parse_xml(name)
    if root.tag == "robot":
        check_urdf_names(name, root)
    # without a handler MuJoCo writes its warnings to a file in the working directory; those that
    # matter here are detected again by the users of the joint
    mujoco.set_mju_user_warning(lambda _: None)
    try:
        return _mechanism(mujoco.MjSpec.from_file(name), root)
    except (ValueError, mujoco.FatalError) as error:
        raise _unreadable(name, error) from error
    finally:
        mujoco.set_mju_user_warning(None)


def _mechanism(spec: Any, root: ET.Element) -> Mechanism:
    if root.tag == "robot":
        # MuJoCo adds a world body above the root link, which is not a frame of the file
        world = "world" if any(link.get("name") == "world" for link in root.iter("link")) else ""
        return Mechanism(
            name=root.get("name", ""),
            frames=_frames(spec, world, urdf_extras(root)),
            mimic_joints=urdf_mimic_joints(root),
        )
    frames = _frames(spec, "world", UrdfExtras({}, {}, {}))
    mimic_joints = _mjcf_mimic_joints(spec)
    tendons = {tendon.name: _coefficients(tendon) for tendon in spec.tendons}
    tied = _tied_by_tendons(spec, tendons, mimic_joints)
    return Mechanism(
        name=spec.modelname,
        frames=frames,
        mimic_joints=mimic_joints,
        left_out=(
            *(
                LeftOut(f"tendon {name or 'without a name'}", tuple(joints))
                for name, joints in tendons.items()
                if name not in tied
            ),
            *(
                LeftOut(f"{equality.type.name[5:].lower()} of {equality.name1}", ())
                for equality in spec.equalities
                if equality.active and equality.type in _LOOPS
            ),
        ),
    )


def _unreadable(name: str, error: Exception) -> HeadFileError:
    """Error with MuJoCo's message on a file that it cannot read."""
    reason = " ".join(str(error).split())
    return HeadFileError(name, reason, f"{EXPECTED} that MuJoCo can read")


def _mjcf_mimic_joints(spec: Any) -> dict[str, MimicJoint]:
    """Couplings by active joint equalities, `y - y0 = a0 + a1 (x - x0)`; y0, x0: references."""
    references = {joint.name: float(joint.ref) * _unit(joint) for joint in spec.joints}
    mimic_joints = {}
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
        mimic_joints[follower] = MimicJoint(follower, master, factor, offset)
    return mimic_joints


def _coefficients(tendon: Any) -> dict[str, float]:
    """Coefficient by joint of a fixed tendon; empty for a spatial one."""
    wraps = [wrap for wrap in tendon.path if wrap.type == mujoco.mjtWrap.mjWRAP_JOINT]
    return {wrap.target.name: float(wrap.coef) for wrap in wraps}


def _tied_by_tendons(
    spec: Any, tendons: Mapping[str, Mapping[str, float]], mimic_joints: dict[str, MimicJoint]
) -> set[str]:
    """Add the couplings by active equalities of fixed tendons, and return these tendons' names.

    For the tendons' changes x, y from the references: `y = a0 + a1 x`, or `y = a0` for one alone.
    """
    references = {joint.name: float(joint.ref) * _unit(joint) for joint in spec.joints}
    tied = set()
    for equality in spec.equalities:
        if equality.type != mujoco.mjtEq.mjEQ_TENDON or not equality.active:
            continue
        names = [name for name in (equality.name1, equality.name2) if name]
        if not all(tendons.get(name) for name in names):
            continue
        tied.update(names)
        offset, factor, *higher = (float(value) for value in equality.data[:5])
        terms = dict(tendons[names[0]])
        for joint, coefficient in tendons[names[1]].items() if len(names) > 1 else ():
            terms[joint] = terms.get(joint, 0.0) - factor * coefficient
        terms = {joint: coefficient for joint, coefficient in terms.items() if coefficient}
        free = [joint for joint in terms if joint not in mimic_joints]
        if not free:
            continue
        follower = free[-1]
        scale = terms.pop(follower)
        offset = offset / scale + references[follower]
        offset += sum(c / scale * references[joint] for joint, c in terms.items())
        factors = [-coefficient / scale for coefficient in terms.values()] or [0.0]
        straight = len(factors) == 1 and not (any(higher) and len(names) > 1)
        mimic_joints[follower] = MimicJoint(
            follower, " and ".join(terms), factors[0] if straight else np.nan, offset
        )
    return tied


def _frames(spec: Any, world: str, extras: UrdfExtras) -> tuple[Frame, ...]:
    frames: list[Frame] = []
    speeds = _servo_speeds(spec)
    pending = [(spec.worldbody, -1)]
    while pending:
        body, parent = pending.pop(0)
        index = len(frames)
        name = body.name if index else world
        joints = tuple(
            _joint(spec, joint, f"{name}#{i}", extras.joint_limits, speeds)
            for i, joint in enumerate(body.joints)
        )
        if name in extras.planar_floating_joints:  # MuJoCo splits a planar joint into three
            whole, kind = extras.planar_floating_joints[name]
            joints = tuple(replace(joint, name=whole, kind=kind) for joint in joints[:1])
        pose = _placed(spec, body)
        fault = extras.link_faults.get(name, "")
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
    """Radians or metres per unit of the file."""
    hinge = joint.type in (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_BALL)
    return np.pi / 180.0 if hinge and joint.compiler.degree else 1.0


def _servo_speeds(spec: Any) -> dict[str, float]:
    """Speed limits by joint, from the control ranges of an MJCF's velocity servos, rad/s."""
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
    """(4, 4) pose of an element in its body or, for a body, in its parent."""
    with np.errstate(invalid="ignore"):  # an infinite one is refused later
        return np.asarray(_frames_around(spec, element) @ _pose(spec, element))


def _frames_around(spec: Any, element: Any) -> FloatArray:
    """(4, 4) product of the nested <frame> elements of an MJCF that contain an element."""
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
    """Numbers as written in the file, from MuJoCo's single-precision values."""
    return np.array([float(str(np.float32(value))) for value in values])


def _camera(camera: Any) -> MjcfCamera:
    """Image parameters of a camera; one pixel, MuJoCo's default, is no given resolution."""
    fault = ""
    if camera.mode != mujoco.mjtCamLight.mjCAMLIGHT_FIXED:
        fault = "turns by itself after something (its mode is not fixed)"
    elif camera.proj != mujoco.mjtProjection.mjPROJ_PERSPECTIVE:
        fault = "has a projection that is not perspective"
    fovy = float(camera.fovy)
    size = np.array(camera.resolution, dtype=np.float64)
    if size.max() <= 1.0:
        return MjcfCamera(size=None, focal=None, fovy_deg=fovy, principal=None, fault=fault)
    focal, offset = _decimals(camera.focal_pixel), _decimals(camera.principal_pixel)
    sensor = _decimals(camera.sensor_size)
    if sensor.min() > 0.0:
        if not focal.any():
            focal = _decimals(camera.focal_length) / sensor * size
        if not offset.any():
            offset = _decimals(camera.principal_length) / sensor * size
    known = bool(sensor.min() > 0.0 and focal.min() > 0.0)
    return MjcfCamera(
        size=(int(size[0]), int(size[1])),
        focal=focal if known else None,
        fovy_deg=fovy,
        fault=fault,
        # MuJoCo's offset points from the image centre left and up; its pixel edges are at integers
        principal=size / 2.0 - offset - 0.5 if known else None,
    )
