"""Joints, links and cameras of a robot's URDF or MJCF."""

import os
import xml.etree.ElementTree as ET
from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from difflib import get_close_matches
from pathlib import Path
from typing import Any, Final, Literal, NoReturn

import numpy as np

from vergence.errors import ConfigurationError, HeadFileError, UnquotedText, UnreadableFileError
from vergence.models.mujoco import mujoco
from vergence.models.parts import FloatArray

FrameKind = Literal["body", "site", "camera"]


@dataclass(frozen=True, kw_only=True, eq=False)
class Joint:
    """A joint that moves a frame relative to its parent; angles in radians, slides in metres."""

    name: str  # derived from its frame if the file gives none
    kind: str  # hinge, slide, ball, free; of a URDF planar and floating, too
    anchor: FloatArray  # (3,) point on the axis, in the moving frame
    axis: FloatArray  # (3,) unit vector in the moving frame
    reference: float = 0.0  # joint value at which the frame is at `Frame.pose`
    lower: float = np.nan  # nan if the file has none, as those below
    upper: float = np.nan
    velocity: float = np.nan  # speed limit

    def motion(self, value: float) -> FloatArray:
        """(4, 4) pose of the frame at a joint value, relative to its pose at the reference."""
        turned = np.eye(4)
        if self.kind == "slide":
            turned[:3, 3] = (value - self.reference) * self.axis
        else:
            turned[:3, :3] = self.rotation(value - self.reference)
            turned[:3, 3] = self.anchor - turned[:3, :3] @ self.anchor
        return turned

    def rotation(self, angle_rad: float) -> FloatArray:
        """(3, 3) rotation about the axis, by Rodrigues' formula."""
        x, y, z = self.axis
        cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        # 1 - cos without the loss of digits at small angles
        versine = 2.0 * np.sin(angle_rad / 2.0) ** 2
        return np.asarray(np.eye(3) + np.sin(angle_rad) * cross + versine * cross @ cross)


@dataclass(frozen=True, eq=False)
class Frame:
    """A frame of the tree."""

    name: str
    kind: FrameKind  # body (link of a URDF), or a site or camera fixed to one
    parent: "Frame | None"  # None for the root
    pose: FloatArray  # (4, 4) in its parent, joints at their references
    joints: tuple[Joint, ...] = ()  # in the order in which they are applied
    camera: Any = None  # MuJoCo's, of an MJCF
    fault: str = ""  # why no path to a camera may pass, or empty

    def lineage(self) -> "list[Frame]":
        """The frames from the root to this one, both included."""
        found = [self]
        while found[-1].parent is not None:
            found.append(found[-1].parent)
        return found[::-1]


@dataclass(frozen=True)
class MimicJoint:
    """`joint = multiplier * master + offset`; the multiplier is 0 if held, nan if not linear."""

    joint: str
    master: str
    multiplier: float
    offset: float

    def follow(self, values: Mapping[str, float]) -> float:
        """Value of the joint; a master without a value is at 0."""
        return self.multiplier * values.get(self.master, 0.0) + self.offset


@dataclass(frozen=True, kw_only=True, eq=False)
class Mechanism:
    """Frames, parents before children, with their joints and the couplings of these."""

    name: str
    frames: tuple[Frame, ...]
    mimic_joints: Mapping[str, MimicJoint]  # by name of the coupled joint
    left_out: Sequence[tuple[str, tuple[str, ...]]] = ()
    """Name of what ties joints and is in no mechanism here, with the joints; none if bodies."""

    def joints(self) -> dict[str, Joint]:
        """All joints by name."""
        return {joint.name: joint for frame in self.frames for joint in frame.joints}

    def find_frame(self, name: str, option: str, prefer: tuple[FrameKind, ...]) -> Frame:
        """Frame by name, or by `site:NAME`; `prefer` orders the search among kinds."""
        kind, colon, rest = name.partition(":")
        if colon and kind in prefer:
            prefer, name = (kind,), rest
        known = [frame for kind in prefer for frame in self.frames if frame.kind == kind]
        for frame in known if name else ():
            if frame.name == name:
                return frame
        root = next((f.name for f in self.frames if f.kind == "body" and f.name), "")
        below = f" (the root of the file is {root})" if option == "base" and root else ""
        hint = known_names_hint("frame", name, [frame.name for frame in known])
        refuse(option, hint, f"{name!r}{below}")

    def pose_along(self, frames: Iterable[Frame], values: Mapping[str, float]) -> FloatArray:
        """(4, 4) product of the poses of frames; other joints are tied, or at references."""
        pose = np.eye(4)
        for frame in frames:
            pose = pose @ frame.pose
            for joint in frame.joints:
                value = values.get(joint.name)
                if value is None:
                    tie = self.mimic_of(joint.name)
                    value = joint.reference if tie is None else tie.follow(values)
                pose = pose @ joint.motion(value)
        return pose

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
                circle = f"a circle of them ({', '.join(sorted(seen))})"
                refuse(f"joint {joint}", "it to follow another joint", circle)
            seen.add(master)
        return None if master == joint else MimicJoint(joint, master, factor, offset)


_MAX_NAMES_SHOWN: Final = 12  # most names that a message lists (chosen)


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


def refuse(owner: str, expected: str, got: object) -> NoReturn:
    """Raise the error of an option, frame or joint."""
    raise ConfigurationError(f"{owner}: expected {expected}, got {got}")


def refuse_unknown(owner: str, kind: str, name: str, names: Collection[str]) -> None:
    """Refuse a name that is none of those in the file."""
    if name not in names:
        refuse(owner, known_names_hint(kind, name, names), repr(name))


_EXPECTED: Final = "a URDF (<robot>) or an MJCF (<mujoco>)"


def _parse_xml(path: str) -> ET.Element:
    try:
        root = ET.fromstring(Path(path).read_bytes())
    except OSError as error:
        raise UnreadableFileError(path, error.strerror or str(error), _EXPECTED) from error
    except (ET.ParseError, ValueError, LookupError) as error:
        raise HeadFileError(path, f"no well-formed XML: {error}", _EXPECTED) from error
    # macros are left to expand; an expanded file may keep xacro's namespace
    tags = any("xacro" in str(each.tag).partition("}")[0] for each in root.iter())
    values = "\n".join(value for each in root.iter() for value in each.attrib.values())
    if tags or "${" in values or "$(" in values:
        expand = f"{_EXPECTED}; expand it first: xacro FILE > head.urdf"
        raise HeadFileError(path, "a xacro file", expand)
    if root.tag not in ("robot", "mujoco"):
        raise HeadFileError(path, f"<{root.tag.rpartition('}')[2]}>", _EXPECTED)
    return root


def _check_urdf_names(path: str, root: ET.Element) -> None:
    """Refuse a URDF with ambiguous names of joints or links, misspelt ones, or unknown links."""
    for tag in (part.tag for part in root):
        if near := _meant(tag, ("joint", "link")):
            meant = f"no such element (is <{near}> meant?)"
            raise HeadFileError(path, UnquotedText(f"<{tag}>"), meant)
    for tag in ("joint", "link"):
        for name, count in Counter(each.get("name") for each in root.findall(tag)).items():
            if name and count > 1:
                two = UnquotedText(f"two called {name!r}")
                raise HeadFileError(path, two, f"{tag}s with different names")
    links = [link.get("name", "") for link in root.findall("link")]
    for joint in root.findall("joint[@name]"):
        for end in ("parent", "child"):
            name = _attributes(joint, end).get("link")
            if name is not None and name not in links:
                hint = f"a {end} that is {known_names_hint('link', name, links)}"
                raise HeadFileError(f"joint {joint.get('name')}", name, hint, path)


def _attributes(joint: ET.Element, tag: str) -> Mapping[str, str]:
    element = joint.find(tag)
    return {} if element is None else element.attrib


def number(text: str | None) -> float:
    """The number that a text gives; nan if there is none."""
    try:
        return np.nan if text is None else float(text)
    except ValueError:
        return np.nan


_LIMITS: Final = ("lower", "upper", "velocity", "effort", "acceleration", "deceleration", "jerk")
_ATTRIBUTES: Final[dict[str, dict[str, int]]] = {
    "origin": {"xyz": 3, "rpy": 3},
    "axis": {"xyz": 3},
    "limit": dict.fromkeys(_LIMITS, 1),
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
    expected = f"joint {joint.get('name', '')}: expected"
    for element in joint:
        tag, known, text = element.tag, _ATTRIBUTES.get(element.tag), (element.text or "").strip()
        if tag in _POSES:
            return f"{expected} a pose as <origin xyz rpy>, got <{tag}>, which is not read"
        if known is None:
            if near := _meant(tag, (*_ATTRIBUTES, *_OTHER_ELEMENTS)):
                return f"{expected} no element <{tag}>, which nothing reads (is <{near}> meant?)"
            continue
        element_with, names = f"{expected} <{tag}> with", ", ".join(known)
        if len(element):
            return f"{element_with} attributes, got <{element[0].tag}> in it"
        if text:
            got = f"the text {text!r:.80}, which nothing reads"
            return f"{element_with} attributes ({names}), got {got}"
        for attribute, value in element.attrib.items():
            if "}" in attribute:  # of a namespace, such as Drake's
                continue
            if attribute not in known:
                got = f"the attribute {attribute!r} = {value!r:.80}, which is not read"
                return f"{element_with} {names}, got {got}"
            count, numbers = known[attribute], [number(word) for word in value.split()]
            bad = np.isnan(numbers) if tag == "limit" else ~np.isfinite(numbers)
            if count and (len(numbers) != count or bad.any()):
                return f"{expected} {count} numbers in {attribute} of <{tag}>, got {value!r:.80}"
    angles = _attributes(joint, "origin").get("rpy", "")
    if any(abs(number(angle)) > _MAX_ORIGIN_ANGLE_RAD for angle in angles.split()):
        origin = "an origin with rpy in radians within one turn"
        return f"{expected} {origin}, got {angles!r:.80} (is it in degrees?)"
    return ""


def _meant(name: str, known: Sequence[str]) -> str:
    """The known name that another one is a slip of; empty if there is none, or no slip."""
    near = get_close_matches(name.lower(), known, n=1, cutoff=0.75)
    return near[0] if near and near[0] != name else ""


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
    ties = {}
    for joint in root.iterfind("joint[mimic]"):
        name, mimic = joint.get("name", ""), _attributes(joint, "mimic")
        factor, offset = number(mimic.get("multiplier", "1")), number(mimic.get("offset", "0"))
        ties[name] = MimicJoint(name, mimic.get("joint", ""), factor, offset)
    # by the link that it moves, of which MuJoCo refuses a second joint
    moving = {_attributes(each, "child").get("link", ""): each for each in root.iterfind("joint")}
    frames = _frames(spec, world, moving)
    return Mechanism(name=root.get("name", ""), frames=frames, mimic_joints=ties)


def _of_mjcf(spec: Any) -> Mechanism:
    tendons = {tendon.name: _coefficients(tendon) for tendon in spec.tendons}
    active = [equality for equality in spec.equalities if equality.active]
    frames = _frames(spec, "world", {})
    references = {joint.name: joint.reference for frame in frames for joint in frame.joints}
    ties, tied = _ties(active, tendons, references)
    left_out = [
        (f"tendon {name or 'without a name'}", tuple(joints))
        for name, joints in tendons.items()
        if name not in tied
    ]
    loops = [equality for equality in active if equality.type in _LOOPS]
    left_out += [(f"{each.type.name[5:].lower()} of {each.name1}", ()) for each in loops]
    return Mechanism(name=spec.modelname, frames=frames, mimic_joints=ties, left_out=left_out)


def _coefficients(tendon: Any) -> dict[str, float]:
    """Coefficient by joint of a fixed tendon; empty for a spatial one."""
    wraps = [wrap for wrap in tendon.path if wrap.type == mujoco.mjtWrap.mjWRAP_JOINT]
    if any(wrap.target is None for wrap in wraps):
        raise ValueError(f"tendon {tendon.name} with a joint that is not in the file")
    return {wrap.target.name: float(wrap.coef) for wrap in wraps}


def _ties(
    equalities: Sequence[Any],
    tendons: Mapping[str, Mapping[str, float]],
    references: Mapping[str, float],
) -> tuple[dict[str, MimicJoint], set[str]]:
    """Couplings by equalities of joints and of fixed tendons, and these tendons' names.

    For the changes x, y of two from the references: `y = a0 + a1 x`, or `y = a0` for one alone.
    """
    found: dict[str, MimicJoint] = {}
    tied: set[str] = set()
    of_joints, of_tendons = mujoco.mjtEq.mjEQ_JOINT, mujoco.mjtEq.mjEQ_TENDON
    for equality in (e for kind in (of_joints, of_tendons) for e in equalities if e.type == kind):
        names = [name for name in (equality.name1, equality.name2) if name]
        is_joint = equality.type == of_joints
        sums = [{name: 1.0} if is_joint else tendons.get(name, {}) for name in names]
        if not all(sums):
            continue
        offset, factor, *higher = (float(value) for value in equality.data[:5])
        terms = dict(sums[0])
        for joint, coefficient in (item for other in sums[1:] for item in other.items()):
            terms[joint] = terms.get(joint, 0.0) - factor * coefficient
        follower = names[0]
        if not is_joint:
            tied.update(names)
            terms = {joint: coefficient for joint, coefficient in terms.items() if coefficient}
            free = [joint for joint in terms if joint not in found]
            if not free:
                continue
            follower = free[-1]
        scale = terms.pop(follower)
        offset = offset / scale + references.get(follower, 0.0)
        offset += sum(c / scale * references.get(joint, 0.0) for joint, c in terms.items())
        factors = [-coefficient / scale for coefficient in terms.values()] or [0.0]
        straight = len(factors) == 1 and not (any(higher) and len(names) > 1)
        multiplier = factors[0] if straight else np.nan
        found[follower] = MimicJoint(follower, " and ".join(terms), multiplier, offset)
    return found, tied


def _frames(spec: Any, world: str, urdf: Mapping[str, ET.Element]) -> tuple[Frame, ...]:
    """Frames, parents first; `urdf` has the joint's element of each link of a URDF."""
    frames: list[Frame] = []
    speeds = _servo_speeds(spec)
    bodies: list[tuple[Any, Frame | None]] = [(spec.worldbody, None)]
    for body, parent in bodies:  # grows by the children of each
        name, said = body.name if parent else world, ""
        joints = [_joint(spec, each, f"{name}#{i}", speeds) for i, each in enumerate(body.joints)]
        if name in urdf:
            joints, said = _urdf_joints(joints, urdf[name]), _fault(urdf[name])
        link = Frame(name, "body", parent, _pose(spec, body), tuple(joints), fault=said)
        sites = [Frame(each.name, "site", link, _pose(spec, each)) for each in body.sites]
        cameras = [Frame(c.name, "camera", link, _pose(spec, c), camera=c) for c in body.cameras]
        frames += [link, *sites, *cameras]
        bodies += [(child, link) for child in body.bodies]
    return tuple(frames)


def _urdf_joints(joints: Sequence[Joint], element: ET.Element) -> list[Joint]:
    """MuJoCo's joints of a link with what its parser drops or changes."""
    kind, limit = element.get("type", ""), _attributes(element, "limit")
    more: dict[str, Any] = {"velocity": number(limit.get("velocity"))}
    given = kind != "continuous" and not limit.keys().isdisjoint(("lower", "upper"))
    for end in ("lower", "upper"):  # a missing one of the two is 0
        more[end] = number(limit.get(end, "0")) if given else np.nan
    if kind in ("planar", "floating"):  # MuJoCo splits a planar joint into three
        more |= {"name": element.get("name", ""), "kind": kind}
    return [replace(joint, **more) for joint in joints[:1]]


def _joint(spec: Any, joint: Any, unnamed: str, speeds: Mapping[str, float]) -> Joint:
    around = _pose(spec, joint.frame)
    axis = around[:3, :3] @ np.array(joint.axis, dtype=np.float64)
    length = float(np.linalg.norm(axis))
    turns = joint.type in (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_BALL)
    unit = np.pi / 180.0 if turns and joint.compiler.degree else 1.0
    lower, upper = (float(value) * unit for value in joint.range)
    auto = joint.limited == mujoco.mjtLimited.mjLIMITED_AUTO and spec.compiler.autolimits
    limited = joint.limited == mujoco.mjtLimited.mjLIMITED_TRUE or (auto and lower != upper)
    name = joint.name or unnamed
    return Joint(
        name=name,
        kind=joint.type.name.removeprefix("mjJNT_").lower(),
        anchor=(around @ np.append(joint.pos, 1.0))[:3],
        axis=axis / length if length > 0.0 else np.full(3, np.nan),
        reference=float(joint.ref) * unit,
        lower=lower if limited else np.nan,
        upper=upper if limited else np.nan,
        velocity=speeds.get(name, np.nan),
    )


_VELOCITY_SERVO: Final = ["mjTRN_JOINT", "mjGAIN_FIXED", "mjBIAS_AFFINE", "mjDYN_NONE"]


def _servo_speeds(spec: Any) -> dict[str, float]:
    """Speed limits by joint, from the control ranges of an MJCF's velocity servos, rad/s."""
    speeds = {}
    for servo in spec.actuators:
        types = servo.trntype, servo.gaintype, servo.biastype, servo.dyntype
        gain, bias, gear = servo.gainprm[0], servo.biasprm, abs(float(servo.gear[0]))
        by_speed = bias[0] == bias[1] == 0.0 < gain == -bias[2]
        is_servo = [each.name for each in types] == _VELOCITY_SERVO and by_speed
        limited = servo.ctrllimited != mujoco.mjtLimited.mjLIMITED_FALSE
        if is_servo and gear and limited and servo.ctrlrange[0] < servo.ctrlrange[1]:
            speeds[servo.target] = min(abs(float(end)) for end in servo.ctrlrange) / gear
    return speeds


@np.errstate(invalid="ignore")  # an infinite pose is refused later
def _pose(spec: Any, element: Any) -> FloatArray:
    """(4, 4) pose in the body, or the parent body, through the <frame> elements around it."""
    pose = np.eye(4)
    if element is None:
        return pose
    quat, alt, compiler = element.quat, element.alt, element.compiler
    if alt.type != mujoco.mjtOrientation.mjORIENTATION_QUAT:
        units = {"degree": compiler.degree, "sequence": compiler.eulerseq}
        quat = spec.resolve_orientation(orientation=alt, **units)
    quat = np.array(quat, dtype=np.float64)
    w, x, y, z = quat / np.linalg.norm(quat)
    pose[:3, :3] = [
        [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
        [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
        [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
    ]
    pose[:3, 3] = element.pos
    return np.asarray(_pose(spec, element.frame) @ pose)
