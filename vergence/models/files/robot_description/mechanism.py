"""A mechanism: a tree of frames and the joints that move them, whatever file described it."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from typing import Final, Literal

import numpy as np

from vergence.errors import ConfigurationError
from vergence.models.parts import FloatArray

JointKind = Literal["hinge", "slide", "ball", "free", "planar", "floating"]
FrameKind = Literal["body", "site", "camera"]


@dataclass(frozen=True, kw_only=True, eq=False)
class Joint:
    """How a frame moves against its parent; angles in radians, slides in metres.

    Attributes:
        name: its name; made up from its frame where the file gives none.
        kind: hinge (URDF: revolute, continuous), slide (prismatic), ball or free (MJCF), planar
            or floating (URDF).
        anchor: (3,) a point of the axis in the frame that moves.
        axis: (3,) unit vector in the frame that moves.
        reference: the joint's value at which the frame lies as `Frame.pose` says.
        lower: lower limit; nan where the file has none.
        upper: upper limit; nan where the file has none.
        velocity: greatest speed; nan where the file has none.
    """

    name: str
    kind: JointKind
    anchor: FloatArray
    axis: FloatArray
    reference: float = 0.0
    lower: float = np.nan
    upper: float = np.nan
    velocity: float = np.nan

    def motion(self, value: float) -> FloatArray:
        """(4, 4) where the joint's value takes the frame, in its place at the reference."""
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
class SpecCamera:
    """What an MJCF says of a camera's image; None where it says nothing.

    Attributes:
        size: width and height, pixels.
        focal: (2,) focal lengths in pixels; None where only `fovy_deg` tells.
        fovy_deg: vertical field of view, degrees.
        principal: (2,) principal point, pixels; centres of pixels at integers.
        fault: why it can be no eye; empty if it can.
    """

    size: tuple[int, int] | None
    focal: FloatArray | None
    fovy_deg: float
    principal: FloatArray | None
    fault: str = ""


@dataclass(frozen=True, kw_only=True, eq=False)
class Frame:
    """A frame of the tree.

    Attributes:
        name: its name in the file.
        kind: a body (a link of a URDF), or a site or camera fixed to one.
        parent: index of the frame that it hangs on; -1 for the root.
        pose: (4, 4) in its parent, its joints at their references.
        joints: its joints, in the order in which they are applied.
        camera: what the file says of the image, for a camera.
        fault: why it can be on no way to a camera; empty if it can.
    """

    name: str
    kind: FrameKind
    parent: int
    pose: FloatArray
    joints: tuple[Joint, ...] = ()
    camera: SpecCamera | None = None
    fault: str = ""


@dataclass(frozen=True)
class Tie:
    """A joint that follows another: `joint = multiplier * master + offset`.

    The multiplier is 0, and the master of no matter, where the joint is held in its place, and nan
    where it follows by no straight line.
    """

    joint: str
    master: str
    multiplier: float
    offset: float


@dataclass(frozen=True, kw_only=True, eq=False)
class Mechanism:
    """Frames, parents before children, with their joints and the ties among these.

    Attributes:
        name: the robot's name in the file.
        frames: the tree.
        ties: joints that follow others, by their names.
    """

    name: str
    frames: tuple[Frame, ...]
    ties: Mapping[str, Tie]

    def joints(self) -> dict[str, Joint]:
        """All joints by name."""
        return {joint.name: joint for frame in self.frames for joint in frame.joints}

    def find(self, name: str, option: str, prefer: tuple[FrameKind, ...]) -> int:
        """The index of the frame of a name.

        Args:
            name: of a body, site or camera; a name that several of these have in common may
                be told apart as `site:NAME`.
            option: what a message calls the place where the name was given.
            prefer: the kinds in the order in which they are looked through.

        Raises:
            ConfigurationError: there is none.
        """
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
            f"{option}: expected {among('frame', name, names)}, got {name!r}{below}"
        )

    def ancestors(self, frame: int) -> list[int]:
        """The frames from the root to this one, both included."""
        found = []
        while frame >= 0:
            found.append(frame)
            frame = self.frames[frame].parent
        return found[::-1]

    def pose(self, frame: int, base: int, values: Mapping[str, float]) -> FloatArray:
        """T_base_frame, (4, 4).

        Args:
            frame: index of the frame.
            base: index of the frame that it is told in.
            values: joint values by name, radians and metres; a joint that is not among them
                follows its tie, or else lies at its reference.
        """
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
        tie = self.tie(joint.name)
        if tie is None:
            return joint.reference
        return tie.multiplier * values.get(tie.master, 0.0) + tie.offset

    def tie(self, joint: str) -> Tie | None:
        """What a joint follows in the end, where what it follows follows others.

        Raises:
            ConfigurationError: it follows itself.
        """
        master, factor, offset = joint, 1.0, 0.0
        seen = {joint}
        while (tie := self.ties.get(master)) is not None:
            master, offset = tie.master, factor * tie.offset + offset
            factor *= tie.multiplier
            if factor == 0.0:
                break
            if master in seen:
                raise ConfigurationError(
                    f"joint {joint}: expected it to follow another joint, got a circle of them "
                    f"({', '.join(sorted(seen))})"
                )
            seen.add(master)
        return None if master == joint else Tie(joint, master, factor, offset)


_SHOWN: Final = 12
"""Names that a message lists."""


def among(what: str, name: str, names: Iterable[str]) -> str:
    """How a message describes the name that was expected: those near it, or the first few."""
    known = sorted({known for known in names if known})
    if not known:
        return f"a {what} (there is none)"
    lowered = {each.lower(): each for each in known}
    near = [lowered[hit] for hit in get_close_matches(name.lower(), lowered, n=5, cutoff=0.5)]
    contained = [each for each in known if name and name.lower() in each.lower()]
    nearest = list(dict.fromkeys([*near, *contained]))[:_SHOWN]
    if nearest:
        return f"a {what} of the file (near: {', '.join(nearest)})"
    more = "" if len(known) <= _SHOWN else f" and {len(known) - _SHOWN} more"
    return f"a {what} of the file ({', '.join(known[:_SHOWN])}{more})"
