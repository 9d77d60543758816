"""Shape of a target: a point, or a board that both eyes must see completely."""

from math import hypot, inf, nan, sqrt
from typing import Final, NamedTuple

import numpy as np

from vergence.kernels import inlined
from vergence.models.kinematics import (
    PackedHead,
    Vector,
    camera_of,
    eye_frames,
    point_in_eye,
    point_to_pixel,
)
from vergence.models.parts import FloatArray

Axes = tuple[Vector, Vector, Vector]


class Board(NamedTuple):
    """A planar target in the form kernels take, with the conditions for its detection."""

    outline: FloatArray
    """(k, 2) points round the board's edge in its own frame, m; none for a mere point."""
    true_size_distance_m: float
    """Distance at which a board that looks equally large near and far has its own size, m; nan
    for a board of constant size."""
    facing_head: bool
    """True if it is square to the line from N's origin, False if parallel to N's xy plane."""
    border_px: float
    """Least distance of the outline from the images' edges, px."""
    min_outline_segment_px: float
    """Least length in the image from one point of the outline to the next, px."""
    max_outline_segment_px: float
    """Greatest such length, px."""


POINT: Final = Board(np.empty((0, 2)), nan, True, 0.0, 0.0, inf)
"""A target without a board: only its measured point must be visible."""


def whole_board_text(board: Board) -> str:
    """Words that error messages add to "see" for targets with a board."""
    if not len(board.outline):
        return ""
    return (
        f" with the whole board, {board.border_px:g} px from the images' edges and not too small "
        "or large for the detector"
    )


@inlined
def board_axes(point: Vector, facing_head: bool) -> Axes:
    """The axes of a board's frame in N: right, down, and into the board.

    Args:
        point: position of its measured point in N, m.
        facing_head: see `Board`.
    """
    if not facing_head:
        return (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
    x, y, z = point
    r = sqrt(x * x + y * y + z * z)
    cx, cy, cz = x / r, y / r, z / r
    s = hypot(cx, cz)
    ax, az = cz / s, -cx / s
    return (ax, 0.0, az), (cy * az, cz * ax - cx * az, -cy * ax), (cx, cy, cz)


@inlined
def mean_camera_distance(p: PackedHead, angles: FloatArray, point: Vector) -> float:
    """Mean distance of a point from both cameras, m.

    Args:
        p: a packed head.
        angles: (4,) the eyes' angles, rad.
        point: in N, m.
    """
    total = 0.0
    for eye in range(2):
        camera = eye_frames(p, eye, angles[2 * eye], angles[2 * eye + 1]).camera
        x, y, z = point[0] - camera.x, point[1] - camera.y, point[2] - camera.z
        total += sqrt(x * x + y * y + z * z)
    return 0.5 * total


@inlined
def is_detectable_by_both_eyes(
    p: PackedHead, angles: FloatArray, point: Vector, border_px: float, board: Board
) -> bool:
    """True if both eyes see a target: its point, and all of its board at a detectable size.

    Args:
        p: a packed head.
        angles: (4,) the eyes' angles, rad.
        point: in N, m.
        border_px: least distance from the images' edges, px; for the outline of a board, the
            board's own border is added.
        board: shape of the target.
    """
    k = len(board.outline)
    size = 1.0
    if k and board.true_size_distance_m == board.true_size_distance_m:
        size = mean_camera_distance(p, angles, point) / board.true_size_distance_m
    right, down, _into = board_axes(point, board.facing_head)
    for eye in range(2):
        camera = camera_of(p, eye)
        border = border_px
        before_u = before_v = 0.0
        # the point itself, then once round the outline and back to where it began
        for i in range(k + 2 if k else 1):
            x, y, z = point
            if i:
                across, along = board.outline[i % k, 0] * size, board.outline[i % k, 1] * size
                x += across * right[0] + along * down[0]
                y += across * right[1] + along * down[1]
                z += across * right[2] + along * down[2]
                border = border_px + board.border_px
            x, y, z = point_in_eye(p, eye, angles[2 * eye], angles[2 * eye + 1], x, y, z)
            u, v = point_to_pixel(p, eye, x, y, z, True)
            if not (border <= u <= camera.width - 1.0 - border):
                return False
            if not (border <= v <= camera.height - 1.0 - border):
                return False
            length = hypot(u - before_u, v - before_v)
            if i > 1 and not board.min_outline_segment_px <= length <= board.max_outline_segment_px:
                return False
            before_u, before_v = u, v
    return True
