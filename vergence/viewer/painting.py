"""The head, its target and its optical axes from outside, painted without OpenGL."""

from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from vergence.envs.reading import Image
from vergence.models.head import HeadModel
from vergence.models.parts import FloatArray
from vergence.models.posture import rest_poses
from vergence.viewer import marks
from vergence.viewer.eye_pictures import EYE_COLOURS, FIX_COLOUR
from vergence.viewer.outside_camera import OutsideCamera, place_outside_camera
from vergence.viewer.rasteriser import Triangles, paint_triangles
from vergence.viewer.shapes import HeadShapes
from vergence.vision.targets import board_pose, make_planar_target, outline_m

_SUBPIXELS: Final = 2
"""Samples of a pixel along each side (chosen: smooth edges against time)."""
_REACH_WITHOUT_TARGET_M: Final = 0.5
"""Distance that is kept in view without a target, m (chosen: an arm's length)."""
_BEYOND: Final = 1.2
"""Length of the optical axes by the target's distance (chosen: they are seen to cross)."""
_LIGHT: Final = np.array([0.35, -0.5, 0.79])
"""Direction to the light in the upright frame (chosen: from above and ahead of the head)."""

# brightness by light from all sides, from above, and from the light (chosen: form without dark
# sides)
_AMBIENT: Final = 0.55
_FROM_ABOVE: Final = 0.15
_DIRECT: Final = 0.5

_LINE_WIDTH: Final = 0.005
"""Half thickness of the optical axes by the picture's height (chosen: legible)."""
_FIX_RADIUS: Final = 0.015
"""Radius of the fix by gaze by the picture's height (chosen: legible, smaller than the board)."""
_BACKGROUND: Final = 232
"""Grey level behind the head, 0 to 255 (chosen: a white board stands out)."""
_SHADOW: Final = 0.13
"""Darkness of the shadow on the floor, 0 to 1 (chosen: it shows where the floor is)."""
_SHADOW_BLUR_PX: Final = 15
"""Softness of the shadow, px (chosen)."""


class HeadPainter:
    """Paints a head from outside: links, eyes, optical axes, target.

    Args:
        head: one head, not a population.
    """

    def __init__(self, head: HeadModel) -> None:
        self._head = head
        self._shapes = HeadShapes(head)
        self._floor_m = rest_poses(head).floor_m
        self._board = make_planar_target("tag")
        meshes = self._shapes.meshes
        counts = [len(mesh.vertices) for mesh in meshes]
        self._first = np.cumsum(counts)[:-1]
        self._body = np.repeat([mesh.body for mesh in meshes], counts)
        self._vertices = np.concatenate([mesh.vertices for mesh in meshes])
        self._normals = np.concatenate([_normals(mesh.vertices, mesh.faces) for mesh in meshes])
        firsts = np.concatenate([[0], self._first])
        self._faces = np.concatenate([m.faces + at for m, at in zip(meshes, firsts, strict=True)])
        colours = np.array([mesh.colour for mesh in meshes], dtype=float)
        self._colours = np.repeat(colours, [len(mesh.faces) for mesh in meshes], axis=0)

    def place_camera(
        self, positions: FloatArray, target: FloatArray, aspect: float
    ) -> OutsideCamera:
        """Place a camera at the head's left side, with both the head and the target in view.

        Args:
            positions: (7,) joint angles, rad.
            target: (3,) in N, m; nan for none.
            aspect: width of the picture by its height.
        """
        frame_n = self._shapes.pose_of_n(positions)
        towards = target if _known(target) else np.array([0.0, 0.0, _REACH_WITHOUT_TARGET_M])
        outline = np.column_stack([outline_m(self._board), np.zeros(4)])
        corners = _moved(frame_n @ board_pose(towards), outline)
        return place_outside_camera(frame_n, self._shapes.baseline_m, towards, corners, aspect)

    def draw(
        self,
        positions: FloatArray,
        target: FloatArray,
        width: int,
        height: int,
        *,
        board: bool = True,
        fix: FloatArray | None = None,
        camera: OutsideCamera | None = None,
    ) -> Image:
        """Paint the head.

        Args:
            positions: (7,) joint angles, rad.
            target: (3,) point to keep in view, in N, m; nan for none.
            width: px.
            height: px.
            board: True to paint the target's board; in front of a robot it is not known.
            fix: (3,) fix by gaze in N, m, to be marked; None or nan for none.
            camera: the camera; None for the one of `place_camera`.

        Returns:
            (height, width, 3) RGB.
        """
        camera = camera or self.place_camera(positions, target, width / height)
        frame_n, poses = self._shapes.pose_of_n(positions), self._shapes.body_poses(positions)
        turns = poses[self._body, :3, :3]
        vertices = np.einsum("vij,vj->vi", turns, self._vertices) + poses[self._body, :3, 3]
        shades = _shade(np.einsum("vij,vj->vi", turns, self._normals))
        parts = [Triangles(vertices[self._faces], shades[self._faces], self._colours)]
        reach = float(np.linalg.norm(target)) if _known(target) else _REACH_WITHOUT_TARGET_M
        middle = _moved(frame_n, np.array([0.0, 0.0, 0.5 * reach]))
        depth = float((middle - camera.position) @ camera.rotation[:, 2])
        height_m = depth / camera.focal  # of the picture, at that depth
        for pose, colour in zip(
            frame_n @ self._head.camera_poses(positions), EYE_COLOURS, strict=True
        ):
            parts.append(marks.rod(pose, _BEYOND * reach, _LINE_WIDTH * height_m, colour))
        if board and _known(target):
            parts.append(marks.board(self._board, frame_n @ board_pose(target)))
        if fix is not None and _known(fix):
            parts.append(marks.ball(_moved(frame_n, fix), _FIX_RADIUS * height_m, FIX_COLOUR))
        focal = _SUBPIXELS * camera.focal * height
        out = self._background(vertices, camera, width, height)
        seen = Triangles(*(np.concatenate(part) for part in zip(*parts, strict=True)))
        seen = seen._replace(corners=(seen.corners - camera.position) @ camera.rotation)
        centre = (0.5 * (out.shape[1] - 1), 0.5 * (out.shape[0] - 1))
        paint_triangles(out, seen, focal, centre)
        return np.asarray(cv2.resize(out, (width, height), interpolation=cv2.INTER_AREA), np.uint8)

    def _background(
        self, vertices: FloatArray, camera: OutsideCamera, width: int, height: int
    ) -> Image:
        """Plain background with the shadow of the head on the floor, at the samples of pixels."""
        mask = np.zeros((height, width), np.uint8)
        fall = np.maximum(vertices[:, 2:] - self._floor_m, 0.0) / _LIGHT[2]
        seen = (vertices - fall * _LIGHT - camera.position) @ camera.rotation
        # every mesh is convex, so its shadow is the hull of its corners' shadows
        for points in np.split(seen, self._first):
            if points[:, 2].min() > 0.0:
                pixels = camera.focal * height * points[:, :2] / points[:, 2:] + [
                    width / 2,
                    height / 2,
                ]
                if np.abs(pixels).max() < 10.0 * (width + height):  # else it is out of view
                    cv2.fillConvexPoly(mask, cv2.convexHull(pixels.astype(np.int32)), 255)
        for _ in range(2):  # a box twice is nearly round, and fast
            mask = np.asarray(cv2.blur(mask, (_SHADOW_BLUR_PX, _SHADOW_BLUR_PX)), np.uint8)
        grey = (_BACKGROUND - _BACKGROUND * _SHADOW / 255.0 * mask).astype(np.uint8)
        size = (_SUBPIXELS * width, _SUBPIXELS * height)
        return np.asarray(cv2.cvtColor(cv2.resize(grey, size), cv2.COLOR_GRAY2RGB), np.uint8)


def _known(point: FloatArray) -> bool:
    return bool(np.isfinite(point).all())


def _moved(pose: FloatArray, points: FloatArray) -> FloatArray:
    """Points (..., 3) moved by a pose (4, 4)."""
    return np.asarray(points @ pose[:3, :3].T + pose[:3, 3])


def _normals(vertices: FloatArray, faces: NDArray[np.int64]) -> FloatArray:
    """(v, 3) unit normals at vertices, means of those of the faces around, by their areas."""
    corners = vertices[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    total = np.zeros_like(vertices)
    for k in range(3):
        np.add.at(total, faces[:, k], normals)
    length = np.linalg.norm(total, axis=1, keepdims=True)
    return np.asarray(total / np.where(length > 0.0, length, 1.0))


def _shade(normals: FloatArray) -> FloatArray:
    """Brightness of surfaces with the given normals (..., 3)."""
    return np.asarray(
        _AMBIENT + _FROM_ABOVE * normals[..., 2] + _DIRECT * np.maximum(normals @ _LIGHT, 0.0)
    )
