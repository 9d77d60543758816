"""A mechanism, independent of file format: a tree of frames and the joints that move them."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from typing import Final, Literal, NamedTuple

import numpy as np

from vergence.errors import ConfigurationError
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


@dataclass(frozen=True, kw_only=True, eq=False)
class MjcfCamera:
    """Image parameters of a camera in an MJCF; None if not given."""

    size: tuple[int, int] | None  # width and height, px
    focal: FloatArray | None  # (2,) px; None if only `fovy_deg` is given
    fovy_deg: float  # vertical field of view
    principal: FloatArray | None  # (2,) px; pixel centres at integers
    fault: str = ""  # reason why it cannot serve as an eye, or empty


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


class LeftOut(NamedTuple):
    """Something that ties joints, and that no mechanism here has."""

    name: str
    joints: tuple[str, ...]
    """The joints that it ties; empty if it ties bodies."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Mechanism:
    """Frames, parents before children, with their joints and the couplings of these."""

    name: str
    frames: tuple[Frame, ...]
    mimic_joints: Mapping[str, MimicJoint]  # by name of the coupled joint
    left_out: tuple[LeftOut, ...] = ()  # parts of the file that tie joints

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

    def pose(self, frame: int, base: int, values: Mapping[str, float]) -> FloatArray:
        """T_base_frame, (4, 4); joints not in `values` follow couplings, or are at references."""
        return np.linalg.inv(self._in_root(base, values)) @ self._in_root(frame, values)

    def _in_root(self, index: int, values: Mapping[str, float]) -> FloatArray:
        pose = np.eye(4)
        for ancestor in self.ancestors(index):
            frame = self.frames[ancestor]
            pose = pose @ frame.pose
            for joint in frame.joints:
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
"""Most names that a message lists (chosen: short messages)."""


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
