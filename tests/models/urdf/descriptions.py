"""Robots for the tests: small files of every kind, and kinematics of a URDF by its definition."""

import xml.etree.ElementTree as ET
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation


def real_robot(name: str) -> Path:
    """A robot's URDF that others wrote and that is not part of this repository."""
    path = Path(__file__).resolve().parents[4] / "shared" / "data" / "heads" / name
    if not path.exists():
        pytest.skip(f"{name} is not beside the repository, in ../shared/data/heads")
    return path


def joint(name, parent, child, *, kind="revolute", xyz="0 0 0", rpy="0 0 0", axis="0 0 1", **more):
    """A joint of a URDF; keywords are attributes of its limit, or `mimic`."""
    mimic = more.pop("mimic", "")
    limit = {"lower": "-0.6", "upper": "0.6", "velocity": "5", "effort": "1"} | more
    kept = " ".join(f'{key}="{value}"' for key, value in limit.items() if value is not None)
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{xyz}" rpy="{rpy}"/><axis xyz="{axis}"/>'
        + ("" if kind == "fixed" else f"<limit {kept}/>")
        + (f"<mimic {mimic}/>" if mimic else "")
        + "</joint>"
    )


def urdf(*joints: str, more: str = "", name: str = "toy") -> str:
    """A URDF of some joints, with a mesh that is nowhere in every link."""
    tree = ET.fromstring(f"<robot>{''.join(joints)}</robot>")
    links = dict.fromkeys(
        element.get("link") for j in tree for element in j if element.tag in ("parent", "child")
    )
    mesh = '<visual><geometry><mesh filename="package://nowhere/m.dae"/></geometry></visual>'
    text = "".join(f'<link name="{link}">{mesh}</link>' for link in links)
    return f'<?xml version="1.0"?><robot name="{name}">{text}{"".join(joints)}{more}</robot>'


OPTICAL = "-1.5707963267948966 0 -1.5707963267948966"
"""URDF's angles of an optical frame in one with x forward and z up."""


def eye(side: str, first: str = "pan", second: str = "tilt", parent: str = "head", **limits) -> str:
    """The joints of an eye in a head with x forward, y left and z up, and its optical frame."""
    y = {"left": 0.03, "right": -0.03}[side]
    axes = {"pan": "0 0 1", "tilt": "0 1 0"}
    one, two, camera = f"{side}_a", f"{side}_b", f"{side}_camera"
    return (
        joint(f"{side}_{first}", parent, one, xyz=f"0.02 {y} 0.05", axis=axes[first], **limits)
        + joint(f"{side}_{second}", one, two, xyz="0.01 0 0", axis=axes[second], **limits)
        + joint(f"{side}_mount", two, camera, kind="fixed", xyz="0.02 0 0.001")
        + joint(f"{side}_optical_joint", camera, f"{side}_optical", kind="fixed", rpy=OPTICAL)
    )


NECK = (
    joint("yaw", "base", "n1", xyz="0 0 0.1", rpy="0.1 -0.2 0.3", axis="0 0.1 1")
    + joint("roll", "n1", "n2", xyz="0 0.01 0.05", axis="1 0 0")
    + joint("pitch", "n2", "head", xyz="0.01 0 0.02", axis="0 1 0")
)  # fmt: skip


class UrdfKinematics:
    """Forward kinematics of a URDF as its definition says, by nothing of the package."""

    def __init__(self, text: str) -> None:
        self.joints = {}
        for element in ET.fromstring(text).findall("joint"):
            origin, axis, mimic = (element.find(tag) for tag in ("origin", "axis", "mimic"))
            numbers = {} if origin is None else origin.attrib
            pose = np.eye(4)
            angles, pose[:3, 3] = (
                np.array(numbers.get(key, "0 0 0").split(), float) for key in ("rpy", "xyz")
            )
            pose[:3, :3] = Rotation.from_euler("xyz", angles).as_matrix()
            direction = "1 0 0" if axis is None else axis.get("xyz")
            self.joints[element.find("child").get("link")] = (
                element.get("name"), element.get("type"), element.find("parent").get("link"), pose,
                np.array(direction.split(), float),
                None if mimic is None else mimic.attrib,
            )  # fmt: skip

    def in_root(self, link: str, angles: Mapping[str, float]) -> np.ndarray:
        """(4, 4) a link in the root link; a joint that is not among the angles is at zero."""
        if link not in self.joints:
            return np.eye(4)
        name, kind, parent, pose, axis, mimic = self.joints[link]
        turned = np.eye(4)
        if kind in ("revolute", "continuous"):
            angle = angles.get(name, 0.0)
            if mimic is not None and name not in angles:
                master = angles.get(mimic["joint"], 0.0)
                angle = float(mimic.get("multiplier", 1)) * master + float(mimic.get("offset", 0))
            turn = Rotation.from_rotvec(angle * axis / np.linalg.norm(axis))
            turned[:3, :3] = turn.as_matrix()
        elif kind == "prismatic":
            turned[:3, 3] = axis / np.linalg.norm(axis) * angles.get(name, 0.0)
        return self.in_root(parent, angles) @ pose @ turned

    def pose(self, link: str, base: str, angles: Mapping[str, float]) -> np.ndarray:
        return np.linalg.inv(self.in_root(base, angles)) @ self.in_root(link, angles)
