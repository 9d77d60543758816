"""Values of a robot's XML that MuJoCo's parser drops: faults by name, limits, mimics, types."""

import xml.etree.ElementTree as ET
from collections import Counter
from collections.abc import Sequence
from difflib import get_close_matches
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from vergence.errors import HeadFileError, UnquotedText, UnreadableFileError
from vergence.models.files.robot_description.mechanism import (
    JointKind,
    MimicJoint,
    known_names_hint,
)

EXPECTED: Final = "a URDF (<robot>) or an MJCF (<mujoco>)"
"""Description of an expected file, for messages."""


def parse_xml(path: str) -> ET.Element:
    """Parse the XML of a URDF or MJCF and return its root."""
    try:
        content = Path(path).read_bytes()
        root = ET.fromstring(content)
    except OSError as error:
        raise UnreadableFileError(path, error.strerror or str(error), EXPECTED) from error
    except (ET.ParseError, ValueError, LookupError) as error:
        raise HeadFileError(path, f"no well-formed XML: {error}", EXPECTED) from error
    if _is_xacro(root):
        raise HeadFileError(
            path, "a xacro file", f"{EXPECTED}; expand it first: xacro FILE > head.urdf"
        )
    if root.tag not in ("robot", "mujoco"):
        raise HeadFileError(path, f"<{root.tag.rpartition('}')[2]}>", EXPECTED)
    return root


def _is_xacro(root: ET.Element) -> bool:
    """True if macros are left to expand; an expanded file may keep xacro's namespace."""
    return any(
        "xacro" in str(element.tag).partition("}")[0]
        or any("${" in value or "$(" in value for value in element.attrib.values())
        for element in root.iter()
    )


def check_urdf_names(path: str, root: ET.Element) -> None:
    """Refuse a URDF with ambiguous names of joints or links, misspelt ones, or unknown links."""
    for part in root:
        near = _near(str(part.tag), ("joint", "link"))
        if near and part.tag != near:
            raise HeadFileError(
                path, UnquotedText(f"<{part.tag}>"), f"no such element (is <{near}> meant?)"
            )
    for tag in ("joint", "link"):
        names = Counter(each.get("name") for each in root.findall(tag))
        for name, count in names.items():
            if name and count > 1:
                raise HeadFileError(
                    path, UnquotedText(f"two called {name!r}"), f"{tag}s with different names"
                )
    links = [link.get("name", "") for link in root.findall("link")]
    for joint in root.findall("joint[@name]"):
        for end in ("parent", "child"):
            element = joint.find(end)
            name = None if element is None else element.get("link")
            if name is not None and name not in links:
                raise HeadFileError(
                    f"joint {joint.get('name')}",
                    name,
                    f"a {end} that is {known_names_hint('link', name, links)}",
                    path,
                )


Limits = dict[str, tuple[float, float, float]]
"""Lower limit, upper limit and speed limit by joint; nan if the file has none."""


class UrdfExtras(NamedTuple):
    """Values of a URDF that MuJoCo's parser drops or changes."""

    joint_limits: Limits
    planar_floating_joints: dict[str, tuple[str, JointKind]]
    """Name and kind of planar and floating joints, by their child link."""
    link_faults: dict[str, str]
    """Reason why no path to a camera may pass a link, by link."""


def urdf_extras(root: ET.Element) -> UrdfExtras:
    """Read the values of `UrdfExtras` from a URDF."""
    extras = UrdfExtras(_limits(root), {}, {})
    for joint in root.findall("joint"):
        name, child, origin = joint.get("name", ""), joint.find("child"), joint.find("origin")
        link = "" if child is None else child.get("link", "")
        if joint.get("type") == "planar":
            extras.planar_floating_joints[link] = name, "planar"
        elif joint.get("type") == "floating":
            extras.planar_floating_joints[link] = name, "floating"
        angles = "" if origin is None else origin.get("rpy", "")
        if any(abs(_number(angle)) > _MAX_ORIGIN_ANGLE_RAD for angle in angles.split()):
            extras.link_faults[link] = (
                f"joint {name}: expected an origin with rpy in radians within one turn, got "
                f"{angles!r:.80} (is it in degrees?)"
            )
        if fault := _unread(joint):
            extras.link_faults[link] = f"joint {name}: {fault}"
    return extras


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


def _unread(joint: ET.Element) -> str:
    """Part of a joint that every reader would drop without a word, as a phrase; empty if none."""
    for element in joint:
        known = _ATTRIBUTES.get(element.tag)
        if known is None and element.tag in _OTHER_ELEMENTS:
            continue
        if element.tag in _POSES:
            return f"expected a pose as <origin xyz rpy>, got <{element.tag}>, which is not read"
        if known is None:
            if near := _near(str(element.tag), (*_ATTRIBUTES, *_OTHER_ELEMENTS)):
                return (
                    f"expected no element <{element.tag}>, which nothing reads (is <{near}> meant?)"
                )
            continue
        if len(element):
            return f"expected <{element.tag}> with attributes, got <{element[0].tag}> in it"
        if (element.text or "").strip():
            return (
                f"expected <{element.tag}> with attributes ({', '.join(known)}), got the text "
                f"{(element.text or '').strip()!r:.80}, which nothing reads"
            )
        for attribute, text in element.attrib.items():
            if "}" in attribute:  # of a namespace, such as Drake's
                continue
            if attribute not in known:
                return (
                    f"expected <{element.tag}> with {', '.join(known)}, got the attribute "
                    f"{attribute!r} = {text!r:.80}, which is not read"
                )
            numbers = [_number(word) for word in text.split()]
            if known[attribute] and (
                len(numbers) != known[attribute]
                or np.isnan(numbers).any()
                or (element.tag != "limit" and np.isinf(numbers).any())
            ):
                return (
                    f"expected {known[attribute]} numbers in {attribute} of "
                    f"<{element.tag}>, got {text!r:.80}"
                )
    return ""


def _near(name: str, known: Sequence[str]) -> str:
    """The known name that another one is a slip of; empty if there is none."""
    return next(iter(get_close_matches(name.lower(), known, n=1, cutoff=0.75)), "")


_MAX_ORIGIN_ANGLE_RAD: Final = 6.29
"""Largest angle of an origin, rad: 2 pi, rounded up; larger angles are taken for degrees
(chosen: accepts a rounded full turn)."""


def _limits(root: ET.Element) -> Limits:
    """Read the limits of a URDF's joints; MuJoCo's parser drops the speed limits."""
    found: Limits = {}
    for joint in root.findall("joint"):
        limit = joint.find("limit")
        values = {} if limit is None else limit.attrib
        lower = upper = np.nan
        if joint.get("type") != "continuous" and ("lower" in values or "upper" in values):
            # a missing one of the two is 0
            lower, upper = (_number(values.get(end, "0")) for end in ("lower", "upper"))
        found[joint.get("name", "")] = (lower, upper, _number(values.get("velocity")))
    return found


def urdf_mimic_joints(root: ET.Element) -> dict[str, MimicJoint]:
    """Read the mimic couplings of a URDF."""
    mimic_joints = {}
    for joint in root.findall("joint"):
        mimic = joint.find("mimic")
        if mimic is not None:
            name = joint.get("name", "")
            factor = _number(mimic.get("multiplier", "1"))
            mimic_joints[name] = MimicJoint(
                name, mimic.get("joint", ""), factor, _number(mimic.get("offset", "0"))
            )
    return mimic_joints


def _number(text: str | None) -> float:
    try:
        return np.nan if text is None else float(text)
    except ValueError:
        return np.nan
