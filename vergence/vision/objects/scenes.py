"""What stands in the room: a ball or a poster, and what a ray hits."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import ArrayLike

from vergence.errors import ConfigurationError, UnreadableFileError
from vergence.models.parts import FloatArray
from vergence.operands import as_operand
from vergence.vision.objects.targets import parse_rgb
from vergence.vision.objects.walls import HIGH_M, LOW_M, read_colours

_FORM: Final = (
    "ball, ball:#ff8000, ball:#ff8000:80, poster, poster:200, poster:FILE, poster:FILE:200 "
    "(lengths in mm) or room (nothing but the room)"
)
_POSTER_M: Final = 0.3
"""Width of a poster if none is stated, m (chosen: a printed sheet, A3)."""
_BALL_M: Final = 0.08
"""Diameter of a ball if none is stated, m (chosen: fits a hand)."""
_LARGEST_M: Final = 2.0
"""Largest thing, m (chosen: the room is 3 m high)."""
BORDER: Final = 0.03
"""Width of a poster's white border as a share of the poster's (chosen: looks)."""


@dataclass(frozen=True, kw_only=True)
class Scene:
    """What stands in the room, and what is on its front wall; see `parse_scene`."""

    thing: Literal["ball", "poster", "nothing"] = "poster"
    """What stands at the target's place."""
    colour: tuple[int, int, int] = (255, 128, 0)
    """Red, green and blue of a ball, sRGB levels."""
    size_m: float = 0.08
    """Diameter of the ball, or width of the poster with its border, m."""
    picture: str | None = None
    """Image file on the poster, such as a printed face; None for a procedural texture."""
    measured_m: tuple[float, float] = (0.0, 0.0)
    """Point of the poster at the target's place, right and down from its middle, m."""
    wall: str | None = None
    """Image file on the room's front wall; None for a procedural texture."""

    @property
    def target(self) -> str:
        """Text of the target that looks at the thing, see `parse_gaze_target`."""
        return f"colour:#{bytes(self.colour).hex()}" if self.thing == "ball" else "point"

    def __post_init__(self) -> None:
        if not 0.0 < self.size_m <= _LARGEST_M:
            raise ConfigurationError(
                f"scene: expected a thing of up to {_LARGEST_M:g} m, got {self.size_m:g} m"
            )

    def __str__(self) -> str:
        size = f"{1000.0 * self.size_m:.10g}"
        if self.thing == "nothing":
            return "room"
        what = f"#{bytes(self.colour).hex()}" if self.thing == "ball" else self.picture
        return ":".join([self.thing, *([what] if what else []), size])


def parse_scene(text: str, wall: str | None = None) -> Scene:
    """Parse the text form of a scene, which ``str(scene)`` gives back.

    Args:
        text: ``ball``, ``ball:#ff8000``, ``ball:#ff8000:80``, ``poster``, ``poster:200``,
            ``poster:FILE`` or ``poster:FILE:200``; a ball's diameter or a poster's width in mm. A
            FILE may have colons in its name. ``room``: nothing.
        wall: image file for the front wall; None for a procedural texture.

    Raises:
        ConfigurationError: the text has none of these forms, a value is invalid, or a file cannot
            be read as an image.
    """
    kind, _, rest = str(text).strip().partition(":")
    kind = kind.lower()
    name, _, last = rest.partition(":") if kind == "ball" else rest.rpartition(":")
    if kind == "poster" and (_length_m(last) is None or (name and Path(rest).is_file())):
        name, last = rest, ""
    size_m = _length_m(last) if last else _POSTER_M if kind == "poster" else _BALL_M
    colour = parse_rgb(name) if kind == "ball" and name else Scene.colour
    known = kind in ("ball", "poster") or (kind == "room" and not rest)
    if not known or size_m is None or colour is None:
        raise ConfigurationError(f"scene: expected {_FORM}; got {text!r:.100}")
    picture = name if kind == "poster" and name else None
    for what, path in (("scene", picture), ("wall", wall)):
        try:
            if path is not None:
                read_colours(path)
        except UnreadableFileError as error:
            raise ConfigurationError(f"{what}: {error}") from error
    thing: Any = "nothing" if kind == "room" else kind
    return Scene(thing=thing, colour=colour, size_m=size_m, picture=picture, wall=wall)


def _length_m(text: str) -> float | None:
    """Metres of a length in millimetres; None if it is none."""
    try:
        length = float(text) / 1000.0
    except ValueError:
        return None
    return length if math.isfinite(length) and length > 0.0 else None


def poster_size_m(scene: Scene) -> tuple[float, float]:
    """Width and height of the scene's poster with its border, m; square without a picture."""
    height, width = read_colours(scene.picture).shape[:2] if scene.picture else (1, 1)
    border = BORDER * scene.size_m
    inner = scene.size_m - 2.0 * border
    return scene.size_m, inner * height / width + 2.0 * border


def hit(
    scene: Scene, origin: ArrayLike, direction: ArrayLike, T_0_T: ArrayLike | None = None
) -> FloatArray:
    """First point of the scene's surfaces on a ray.

    Args:
        scene: the room and the thing.
        origin: (3,) start of the ray in frame 0, inside of the room, m.
        direction: (3,) its direction, of any length.
        T_0_T: (4, 4) pose of the thing in frame 0, m; None, or with nan, for none.

    Returns:
        The point, (3,) in frame 0, m.
    """
    start = as_operand("origin", origin, 3)
    along = as_operand("direction", direction, 3)
    along = along / np.linalg.norm(along)
    with np.errstate(divide="ignore"):
        distance = np.where(along > 0.0, HIGH_M - start, LOW_M - start) / along
    least = float(np.min(distance[along != 0.0]))
    pose = None if T_0_T is None else np.asarray(T_0_T, float)
    if scene.thing == "nothing" or pose is None or not np.isfinite(pose).all():
        return start + least * along
    a, b = pose[:3, :3].T @ (start - pose[:3, 3]), pose[:3, :3].T @ along
    if scene.thing == "ball":
        nearest = -float(a @ b)
        squared = nearest**2 - float(a @ a) + (0.5 * scene.size_m) ** 2
        to_thing = nearest - math.sqrt(squared) if squared >= 0.0 else math.inf
    else:
        to_thing = -a[2] / b[2] if b[2] > 0.0 else math.inf
        if not (np.abs((a + to_thing * b)[:2]) <= 0.5 * np.array(poster_size_m(scene))).all():
            to_thing = math.inf
    return start + (to_thing if 0.0 < to_thing < least else least) * along
