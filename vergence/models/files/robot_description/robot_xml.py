"""What of a robot's XML MuJoCo's parser does not tell: faults by name, limits, mimics, types."""

import xml.etree.ElementTree as ET
from collections import Counter
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from vergence.errors import HeadFileError, UnreadableFileError, Words
from vergence.models.files.robot_description.mechanism import JointKind, Tie, among

EXPECTED: Final = "a URDF (<robot>) or an MJCF (<mujoco>)"
"""How messages describe the file."""


def parse_xml(path: str) -> ET.Element:
    """The root of a URDF or MJCF.

    Raises:
        HeadFileError: it cannot be read, or is neither.
    """
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
    """Whether there is anything left to expand; its namespace alone stays in what is expanded."""
    return any(
        "xacro" in str(element.tag).partition("}")[0]
        or any("${" in value or "$(" in value for value in element.attrib.values())
        for element in root.iter()
    )


def check_names(path: str, root: ET.Element) -> None:
    """Refuse a URDF whose joints and links are not told apart, or not there.

    Args:
        path: what messages call the file.
        root: of the URDF.

    Raises:
        HeadFileError: two joints or two links have one name, or a joint hangs on no link.
    """
    for tag in ("joint", "link"):
        names = Counter(each.get("name") for each in root.findall(tag))
        for name, count in names.items():
            if name and count > 1:
                raise HeadFileError(
                    path, Words(f"two called {name!r}"), f"{tag}s with different names"
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
                    f"a {end} that is {among('link', name, links)}",
                    path,
                )


Limits = dict[str, tuple[float, float, float]]
"""Lower and upper limit and speed by joint, nan where the file has none."""


class Written(NamedTuple):
    """What a URDF has of its joints that MuJoCo's parser drops or changes."""

    limits: Limits
    kinds: dict[str, tuple[str, JointKind]]
    """Name and kind of joints that are planar or floating, by the link that they carry."""
    faults: dict[str, str]
    """Why a link can be on no way to a camera, by link."""


def urdf_written(root: ET.Element) -> Written:
    """What is in a URDF besides the mimics, which are ties."""
    written = Written(_limits(root), {}, {})
    for joint in root.findall("joint"):
        name, child, origin = joint.get("name", ""), joint.find("child"), joint.find("origin")
        link = "" if child is None else child.get("link", "")
        if joint.get("type") == "planar":
            written.kinds[link] = name, "planar"
        elif joint.get("type") == "floating":
            written.kinds[link] = name, "floating"
        angles = "" if origin is None else origin.get("rpy", "")
        if any(abs(_number(angle)) > _TURN for angle in angles.split()):
            written.faults[link] = (
                f"joint {name}: expected an origin with rpy in radians within one turn, got "
                f"{angles!r:.80} (is it in degrees?)"
            )
    return written


_TURN: Final = 6.29
"""2 pi, as coarsely as it may be written."""


def _limits(root: ET.Element) -> Limits:
    """The limits of a URDF's joints, whose speeds MuJoCo's parser drops."""
    found: Limits = {}
    for joint in root.findall("joint"):
        limit = joint.find("limit")
        values = {} if limit is None else limit.attrib
        lower = upper = np.nan
        if joint.get("type") != "continuous" and ("lower" in values or "upper" in values):
            # the one that is not written counts as 0
            lower, upper = (_number(values.get(end, "0")) for end in ("lower", "upper"))
        found[joint.get("name", "")] = (lower, upper, _number(values.get("velocity")))
    return found


def urdf_ties(root: ET.Element) -> dict[str, Tie]:
    """The mimics of a URDF."""
    ties = {}
    for joint in root.findall("joint"):
        mimic = joint.find("mimic")
        if mimic is not None:
            name = joint.get("name", "")
            factor = _number(mimic.get("multiplier", "1"))
            ties[name] = Tie(
                name, mimic.get("joint", ""), factor, _number(mimic.get("offset", "0"))
            )
    return ties


def _number(text: str | None) -> float:
    try:
        return np.nan if text is None else float(text)
    except ValueError:
        return np.nan
