"""What of a robot's XML MuJoCo's parser does not tell: whether it is one, limits and mimics."""

import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Final

import numpy as np

from vergence.errors import HeadFileError, UnreadableFileError
from vergence.models.files.robot_description.mechanism import Tie

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


Limits = dict[str, tuple[float, float, float]]
"""Lower and upper limit and speed by joint, nan where the file has none."""


def urdf_limits(root: ET.Element) -> Limits:
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
