"""Joints, links and cameras of a robot's URDF or MJCF."""

import os
import xml.etree.ElementTree as ET
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from difflib import get_close_matches
from pathlib import Path
from typing import Any, Final, Literal, NamedTuple

import numpy as np

from vergence.errors import ConfigurationError, HeadFileError, UnquotedText, UnreadableFileError
from vergence.models.mujoco import mujoco
from vergence.models.parts import FloatArray

JointKind = Literal["hinge", "slide", "ball", "free", "planar", "floating"]
FrameKind = Literal["body", "site", "camera"]


@dataclass(frozen=True, kw_only=True, eq=False)
class Joint:
    """A joint that moves a frame relative to its parent; angles in radians, slides in metres."""

    name: str  # derived from its frame if the file gives none
    kind: JointKind  # URDF's planar and floating, too
    anchor: FloatArray  # (3,) point on the axis, in the moving frame
    axis: FloatArray  # (3,) unit vector in the moving frame
    reference: float = 0.0  # joint value at which the frame is at `Frame.pose`
    lower: float = np.nan  # nan if the file has none, as those below
    upper: float = np.nan
    velocity: float = np.nan  # speed limit

    def motion(self, value: float) -> FloatArray:
        """(4, 4) pose of the frame at a joint value, relative to its pose at the reference."""
        turned = np.eye(4)
        value = value - self.reference
        if self.kind == "slide":
            turned[:3, 3] = value * self.axis
        else:
            turned[:3, :3] = self.rotation(value)
            turned[:3, 3] = self.anchor - turned[:3, :3] @ self.anchor
        return turned

    def rotation(self, angle_rad: float) -> FloatArray:
        """(3, 3) rotation about the axis, by Rodrigues' formula."""
        x, y, z = self.axis
        cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        # 1 - cos without the loss of digits at small angles
        versine = 2.0 * np.sin(angle_rad / 2.0) ** 2
        return np.asarray(np.eye(3) + np.sin(angle_rad) * cross + versine * cross @ cross)


class MjcfCamera(NamedTuple):
    """Image parameters of a camera in an MJCF."""

    size: tuple[int, int] | None  # width and height, px; None if not given
    focal: FloatArray | None  # (2,) px; None if only `fovy_deg` is given
    principal: FloatArray | None  # (2,) px, pixel centres at integers; None as `focal`
    fovy_deg: float  # vertical field of view
    fault: str  # reason why it cannot serve as an eye, or empty


@dataclass(frozen=True, kw_only=True, eq=False)
class Frame:
    """A frame of the tree."""

    name: str
    kind: FrameKind  # body (link of a URDF), or a site or camera fixed to one
    parent: int  # index; -1 for the root
    pose: FloatArray  # (4, 4) in its parent, joints at their references
    joints: tuple[Joint, ...] = ()  # in the order in which they are applied
    camera: MjcfCamera | None = None
    fault: str = ""  # why no path to a camera may pass, or empty


@dataclass(frozen=True)
class MimicJoint:
    """`joint = multiplier * master + offset`; the multiplier is 0 if held, nan if not linear."""

    joint: str
    master: str
    multiplier: float
    offset: float


@dataclass(frozen=True, kw_only=True, eq=False)
class Mechanism:
    """Frames, parents before children, with their joints and the couplings of these."""

    name: str
    frames: tuple[Frame, ...]
    mimic_joints: Mapping[str, MimicJoint]  # by name of the coupled joint
    left_out: tuple[tuple[str, tuple[str, ...]], ...] = ()
    """Name of what ties joints and is in no mechanism here, with the joints; none if bodies."""

    def joints(self) -> dict[str, Joint]:
        """All joints by name."""
        return {joint.name: joint for frame in self.frames for joint in frame.joints}

    def find_frame(self, name: str, option: str, prefer: tuple[FrameKind, ...]) -> int:
        """Index of a frame by name, or by `site:NAME`; `prefer` orders the search among kinds."""
        kind, colon, rest = name.partition(":")
        if colon and kind in prefer:
            prefer, name = (kind,), rest
        for kind in prefer if name else ():
            for index, frame in enumerate(self.frames):
                if frame.kind == kind and frame.name == name:
                    return index
        names = [frame.name for frame in self.frames if frame.kind in prefer]
        root = next((f.name for f in self.frames if f.kind == "body" and f.name), "")
        below = f" (the root of the file is {root})" if option == "base" and root else ""
        raise ConfigurationError(
            f"{option}: expected {known_names_hint('frame', name, names)}, got {name!r}{below}"
        )

    def ancestors(self, frame: int) -> list[int]:
        """Indices of the frames from the root to this one, both included."""
        found = []
        while frame >= 0:
            found.append(frame)
            frame = self.frames[frame].parent
        return found[::-1]

    def pose_along(self, frames: Iterable[int], values: Mapping[str, float]) -> FloatArray:
        """(4, 4) product of the poses of frames; other joints are tied, or at references."""
        pose = np.eye(4)
        for index in frames:
            pose = pose @ self.frames[index].pose
            for joint in self.frames[index].joints:
                pose = pose @ joint.motion(self._value(joint, values))
        return pose

    def _value(self, joint: Joint, values: Mapping[str, float]) -> float:
        if joint.name in values:
            return values[joint.name]
        mimic = self.mimic_of(joint.name)
        if mimic is None:
            return joint.reference
        return mimic.multiplier * values.get(mimic.master, 0.0) + mimic.offset

    def mimic_of(self, joint: str) -> MimicJoint | None:
        """Coupling to the joint at the end of the chain; None if the joint is independent."""
        master, factor, offset = joint, 1.0, 0.0
        seen = {joint}
        while (mimic := self.mimic_joints.get(master)) is not None:
            master, offset = mimic.master, factor * mimic.offset + offset
            factor *= mimic.multiplier
            if factor == 0.0:
                break
            if master in seen:
                raise ConfigurationError(
                    f"joint {joint}: expected it to follow another joint, got a circle of them "
                    f"({', '.join(sorted(seen))})"
                )
            seen.add(master)
        return None if master == joint else MimicJoint(joint, master, factor, offset)


_MAX_NAMES_SHOWN: Final = 12
"""Most names that a message lists (chosen)."""


def known_names_hint(kind: str, name: str, names: Iterable[str]) -> str:
    """Description of an expected name for messages: the names like it, or else the first few."""
    known = sorted({known for known in names if known})
    if not known:
        return f"a {kind} (there is none)"
    lowered = {each.lower(): each for each in known}
    near = [lowered[hit] for hit in get_close_matches(name.lower(), lowered, n=5, cutoff=0.5)]
    contained = [each for each in known if name and name.lower() in each.lower()]
    nearest = list(dict.fromkeys([*near, *contained]))[:_MAX_NAMES_SHOWN]
    if nearest:
        return f"a {kind} of the file (near: {', '.join(nearest)})"
    more = "" if len(known) <= _MAX_NAMES_SHOWN else f" and {len(known) - _MAX_NAMES_SHOWN} more"
    return f"a {kind} of the file ({', '.join(known[:_MAX_NAMES_SHOWN])}{more})"


_EXPECTED: Final = "a URDF (<robot>) or an MJCF (<mujoco>)"


def _parse_xml(path: str) -> ET.Element:
    try:
        root = ET.fromstring(Path(path).read_bytes())
    except OSError as error:
        raise UnreadableFileError(path, error.strerror or str(error), _EXPECTED) from error
    except (ET.ParseError, ValueError, LookupError) as error:
        raise HeadFileError(path, f"no well-formed XML: {error}", _EXPECTED) from error
    # macros are left to expand; an expanded file may keep xacro's namespace
    if any(
        "xacro" in str(element.tag).partition("}")[0]
        or any("${" in value or "$(" in value for value in element.attrib.values())
        for element in root.iter()
    ):
        expand = f"{_EXPECTED}; expand it first: xacro FILE > head.urdf"
        raise HeadFileError(path, "a xacro file", expand)
    if root.tag not in ("robot", "mujoco"):
        raise HeadFileError(path, f"<{root.tag.rpartition('}')[2]}>", _EXPECTED)
    return root


def _check_urdf_names(path: str, root: ET.Element) -> None:
    """Refuse a URDF with ambiguous names of joints or links, misspelt ones, or unknown links."""
    for part in root:
        if near := _meant(part.tag, ("joint", "link")):
            no_element = f"no such element (is <{near}> meant?)"
            raise HeadFileError(path, UnquotedText(f"<{part.tag}>"), no_element)
    for tag in ("joint", "link"):
        for name, count in Counter(each.get("name") for each in root.findall(tag)).items():
            if name and count > 1:
                two = UnquotedText(f"two called {name!r}")
                raise HeadFileError(path, two, f"{tag}s with different names")
    links = [link.get("name", "") for link in root.findall("link")]
    for joint in root.findall("joint[@name]"):
        for end in ("parent", "child"):
            element = joint.find(end)
            name = None if element is None else element.get("link")
            if name is not None and name not in links:
                hint = f"a {end} that is {known_names_hint('link', name, links)}"
                raise HeadFileError(f"joint {joint.get('name')}", name, hint, path)


class _UrdfJoints(NamedTuple):
    """Values of a URDF's joints that MuJoCo's parser drops or changes."""

    limits: dict[str, tuple[float, float, float]]  # lower, upper, speed; nan if there is none
    mimic_joints: dict[str, MimicJoint]
    kinds: dict[str, tuple[str, JointKind]]  # name and kind of planar and floating ones, by child
    faults: dict[str, str]  # why no path to a camera may pass a link, by link


def _urdf_joints(root: ET.Element) -> _UrdfJoints:
    found = _UrdfJoints({}, {}, {}, {})
    for joint in root.findall("joint"):
        name, child, mimic = joint.get("name", ""), joint.find("child"), joint.find("mimic")
        link = "" if child is None else child.get("link", "")
        kind = joint.get("type")
        if kind == "planar":
            found.kinds[link] = name, "planar"
        elif kind == "floating":
            found.kinds[link] = name, "floating"
        if fault := _fault(joint):
            found.faults[link] = f"joint {name}: {fault}"
        if mimic is not None:
            factor, offset = _number(mimic.get("multiplier", "1")), mimic.get("offset", "0")
            found.mimic_joints[name] = MimicJoint(
                name, mimic.get("joint", ""), factor, _number(offset)
            )
        limit = joint.find("limit")
        values = {} if limit is None else limit.attrib
        lower = upper = np.nan
        if kind != "continuous" and ("lower" in values or "upper" in values):
            # a missing one of the two is 0
            lower, upper = (_number(values.get(end, "0")) for end in ("lower", "upper"))
        found.limits[name] = (lower, upper, _number(values.get("velocity")))
    return found


def _number(text: str | None) -> float:
    try:
        return np.nan if text is None else float(text)
    except ValueError:
        return np.nan


_ATTRIBUTES: Final[dict[str, dict[str, int]]] = {
    "origin": {"xyz": 3, "rpy": 3},
    "axis": {"xyz": 3},
    "limit": dict.fromkeys(
        ("lower", "upper", "velocity", "effort", "acceleration", "deceleration", "jerk"), 1
    ),
    "mimic": {"joint": 0, "multiplier": 1, "offset": 1},
    "parent": {"link": 0},
    "child": {"link": 0},
}
"""Count of numbers in each attribute of the elements that place and limit a joint; 0 for a name."""

_POSES: Final = (
    "pose", "position", "transform", "offset", "translation", "rotation", "orientation",
    "quaternion",
)  # fmt: skip
_OTHER_ELEMENTS: Final = ("dynamics", "safety_controller", "calibration")


_MAX_ORIGIN_ANGLE_RAD: Final = 6.29
"""Largest angle of an origin, rad: 2 pi, rounded up; larger angles are taken for degrees
(chosen: accepts a rounded full turn)."""


def _fault(joint: ET.Element) -> str:
    """Part of a joint that every reader would drop, or angles in degrees; empty if none."""
    for element in joint:
        tag, known, text = element.tag, _ATTRIBUTES.get(element.tag), (element.text or "").strip()
        if tag in _POSES:
            return f"expected a pose as <origin xyz rpy>, got <{tag}>, which is not read"
        if known is None:
            if near := _meant(tag, (*_ATTRIBUTES, *_OTHER_ELEMENTS)):
                return f"expected no element <{tag}>, which nothing reads (is <{near}> meant?)"
            continue
        if len(element):
            return f"expected <{tag}> with attributes, got <{element[0].tag}> in it"
        if text:
            return (
                f"expected <{tag}> with attributes ({', '.join(known)}), got the text "
                f"{text!r:.80}, which nothing reads"
            )
        for attribute, value in element.attrib.items():
            if "}" in attribute:  # of a namespace, such as Drake's
                continue
            if attribute not in known:
                return (
                    f"expected <{tag}> with {', '.join(known)}, got the attribute {attribute!r} = "
                    f"{value!r:.80}, which is not read"
                )
            count, numbers = known[attribute], [_number(word) for word in value.split()]
            bad = np.isnan(numbers) if tag == "limit" else ~np.isfinite(numbers)
            if count and (len(numbers) != count or bad.any()):
                return f"expected {count} numbers in {attribute} of <{tag}>, got {value!r:.80}"
    origin = joint.find("origin")
    angles = "" if origin is None else origin.get("rpy", "")
    if any(abs(_number(angle)) > _MAX_ORIGIN_ANGLE_RAD for angle in angles.split()):
        return (
            "expected an origin with rpy in radians within one turn, got "
            f"{angles!r:.80} (is it in degrees?)"
        )
    return ""


def _meant(name: str, known: Sequence[str]) -> str:
    """The known name that another one is a slip of; empty if there is none, or no slip."""
    near = get_close_matches(name.lower(), known, n=1, cutoff=0.75)
    return near[0] if near and near[0] != name else ""


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
    root = _parse_xml(name)
    if root.tag == "robot":
        _check_urdf_names(name, root)
    # without a handler MuJoCo writes its warnings to a file in the working directory; those that
    # matter here are detected again by the users of the joint
    mujoco.set_mju_user_warning(lambda _: None)
    try:
        spec = mujoco.MjSpec.from_file(name)
        return _of_urdf(spec, root) if root.tag == "robot" else _of_mjcf(spec)
    except (ValueError, mujoco.FatalError) as error:
        reason = " ".join(str(error).split())
        raise HeadFileError(name, reason, f"{_EXPECTED} that MuJoCo can read") from error
    finally:
        mujoco.set_mju_user_warning(None)


def _of_urdf(spec: Any, root: ET.Element) -> Mechanism:
    # MuJoCo adds a world body above the root link, which is not a frame of the file
    world = "world" if any(link.get("name") == "world" for link in root.iter("link")) else ""
    joints = _urdf_joints(root)
    return Mechanism(
        name=root.get("name", ""),
        frames=_frames(spec, world, joints),
        mimic_joints=joints.mimic_joints,
    )


def _of_mjcf(spec: Any) -> Mechanism:
    tendons = {tendon.name: _coefficients(tendon) for tendon in spec.tendons}
    active = [equality for equality in spec.equalities if equality.active]
    references = {joint.name: float(joint.ref) * _unit(joint) for joint in spec.joints}
    mimic_joints = _tied_joints(active, references)
    tied = _tie_by_tendons(active, references, tendons, mimic_joints)
    untied = [(name, joints) for name, joints in tendons.items() if name not in tied]
    loops = [equality for equality in active if equality.type in _LOOPS]
    return Mechanism(
        name=spec.modelname,
        frames=_frames(spec, "world", _UrdfJoints({}, {}, {}, {})),
        mimic_joints=mimic_joints,
        left_out=(
            *((f"tendon {name or 'without a name'}", tuple(joints)) for name, joints in untied),
            *((f"{each.type.name[5:].lower()} of {each.name1}", ()) for each in loops),
        ),
    )


def _tied_joints(
    equalities: Sequence[Any], references: Mapping[str, float]
) -> dict[str, MimicJoint]:
    """Couplings by equalities of joints, `y - y0 = a0 + a1 (x - x0)`; y0, x0: references."""
    mimic_joints = {}
    for equality in equalities:
        if equality.type != mujoco.mjtEq.mjEQ_JOINT:
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
    if any(wrap.target is None for wrap in wraps):
        raise ValueError(f"tendon {tendon.name} with a joint that is not in the file")
    return {wrap.target.name: float(wrap.coef) for wrap in wraps}


def _tie_by_tendons(
    equalities: Sequence[Any],
    references: Mapping[str, float],
    tendons: Mapping[str, Mapping[str, float]],
    mimic_joints: dict[str, MimicJoint],
) -> set[str]:
    """Add the couplings by equalities of fixed tendons, and return these tendons' names.

    For the tendons' changes x, y from the references: `y = a0 + a1 x`, or `y = a0` for one alone.
    """
    tied = set()
    for equality in equalities:
        names = [name for name in (equality.name1, equality.name2) if name]
        is_tendon = equality.type == mujoco.mjtEq.mjEQ_TENDON
        if not is_tendon or not all(tendons.get(name) for name in names):
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


def _frames(spec: Any, world: str, urdf: _UrdfJoints) -> tuple[Frame, ...]:
    frames: list[Frame] = []
    speeds = _servo_speeds(spec)
    bodies = [(spec.worldbody, -1)]
    for body, parent in bodies:  # grows by the children of each
        index = len(frames)
        name = body.name if index else world
        joints = tuple(
            _joint(spec, joint, f"{name}#{i}", urdf.limits, speeds)
            for i, joint in enumerate(body.joints)
        )
        if name in urdf.kinds:  # MuJoCo splits a planar joint into three
            whole, kind = urdf.kinds[name]
            joints = tuple(replace(joint, name=whole, kind=kind) for joint in joints[:1])
        frames.append(
            Frame(
                name=name,
                kind="body",
                parent=parent,
                pose=_placed(spec, body),
                joints=joints,
                fault=urdf.faults.get(name, ""),
            )
        )
        frames += [
            Frame(name=site.name, kind="site", parent=index, pose=_placed(spec, site))
            for site in body.sites
        ]
        for camera in body.cameras:
            pose, image = _placed(spec, camera), _camera(camera)
            frames.append(
                Frame(name=camera.name, kind="camera", parent=index, pose=pose, camera=image)
            )
        bodies += [(child, index) for child in body.bodies]
    return tuple(frames)


def _joint(
    spec: Any,
    joint: Any,
    unnamed: str,
    limits: Mapping[str, tuple[float, float, float]],
    speeds: Mapping[str, float],
) -> Joint:
    around = _frames_around(spec, joint)
    axis = around[:3, :3] @ np.array(joint.axis, dtype=np.float64)
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
        anchor=(around @ np.append(joint.pos, 1.0))[:3],
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
        return MjcfCamera(None, None, None, fovy, fault)
    pixels = int(size[0]), int(size[1])
    focal, offset = _decimals(camera.focal_pixel), _decimals(camera.principal_pixel)
    sensor = _decimals(camera.sensor_size)
    if sensor.min() > 0.0:
        if not focal.any():
            focal = _decimals(camera.focal_length) / sensor * size
        if not offset.any():
            offset = _decimals(camera.principal_length) / sensor * size
    if not (sensor.min() > 0.0 and focal.min() > 0.0):
        return MjcfCamera(pixels, None, None, fovy, fault)
    # MuJoCo's offset points from the image centre left and up; its pixel edges are at integers
    return MjcfCamera(pixels, focal, size / 2.0 - offset - 0.5, fovy, fault)
