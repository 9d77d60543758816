"""The head, its target and its optical axes from outside, painted without OpenGL."""

from typing import Final, NamedTuple

import cv2
import numpy as np

from vergence.envs.reading import Image
from vergence.models.boards import board_pose, make_planar_target, outline_m
from vergence.models.head import HeadModel
from vergence.models.mujoco.scene import surroundings_of
from vergence.models.parts import FloatArray
from vergence.viewer.eye_pictures import BACKGROUND_GREY, EYE_COLOURS
from vergence.viewer.rasteriser import Triangles, paint_triangles
from vergence.viewer.shapes import HeadShapes

FIX_COLOUR: Final = (170, 40, 150)
_SUBPIXELS: Final = 2
_LIGHT: Final = np.array([0.35, -0.5, 0.79])
_AXIS_SIDES: Final = 8
_SHADOW: Final = 0.12


class OutsideCamera(NamedTuple):
    """A camera that looks at the head from outside."""

    pose: FloatArray
    """(4, 4) in the upright frame: x right, y down, z forward."""
    focal: float
    """Focal length by the picture's height."""


class HeadPainter:
    def __init__(self, head: HeadModel) -> None:
        self._head = head
        self._shapes = HeadShapes(head)
        self._floor_m = surroundings_of(head).floor_m
        self._normals = [_vertex_normals(m.vertices, m.faces) for m in self._shapes.meshes]
        self._board = make_planar_target("tag")

    def place_camera(
        self, positions: FloatArray, target: FloatArray, aspect: float, azimuth=-145.0,
        elevation=22.0, fov=35.0, ahead=0.5, radius=1.5,
    ) -> OutsideCamera:
        N = self._shapes.pose_of_n(positions)
        size = radius * self._shapes.baseline_m
        head = N[:3, 3] + size * np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T
        towards = target if np.isfinite(target).all() else np.array([0.0, 0.0, 0.5])
        board = N @ board_pose(towards)
        outline = np.column_stack([outline_m(self._board), np.zeros(4), np.ones(4)])
        points = np.concatenate([head, (outline @ board.T)[:, :3]])
        a, e = np.deg2rad([azimuth, elevation])
        back = np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])
        z = -back
        x = np.cross(z, [0.0, 0.0, 1.0]); x /= np.linalg.norm(x)
        pose = np.eye(4)
        pose[:3, :3] = np.column_stack([x, np.cross(z, x), z])
        focal = 0.5 / np.tan(np.deg2rad(0.5 * fov))
        centre = points.mean(axis=0)
        distance = 3.0
        for _ in range(30):
            at = centre - distance * z
            seen = (points - at) @ pose[:3, :3]
            uv = focal * seen[:, :2] / seen[:, 2:]
            low, high = uv.min(axis=0), uv.max(axis=0)
            shift = 0.5 * (low + high) * distance / focal
            centre = centre + pose[:3, :2] @ shift
            fill = np.max((high - low) / [0.94 * aspect, 0.88])
            distance *= fill ** 0.8
        pose[:3, 3] = centre - distance * z
        return OutsideCamera(pose, focal)

    def draw(self, positions, target, width, height, *, board=True, camera=None, fix=None) -> Image:
        N = self._shapes.pose_of_n(positions)
        if camera is None:
            camera = self.place_camera(positions, target, width / height)
        turn, at = camera.pose[:3, :3], camera.pose[:3, 3]
        parts, shadows = [], []
        poses = self._shapes.body_poses(positions)
        for mesh, normals in zip(self._shapes.meshes, self._normals, strict=True):
            pose = poses[mesh.body]
            vertices = mesh.vertices @ pose[:3, :3].T + pose[:3, 3]
            shadows.append(vertices)
            shades = _shade(normals @ pose[:3, :3].T)
            parts.append(_triangles(vertices, mesh.faces, shades, mesh.colour))
        anywhere = bool(np.isfinite(target).all())
        reach = float(np.linalg.norm(target)) if anywhere else 0.5
        thickness = 0.0022 * np.linalg.norm((N @ np.append(0.5 * (target if anywhere else np.zeros(3)), 1))[:3] - at)
        for pose, colour in zip(N @ self._head.camera_poses(positions), EYE_COLOURS, strict=True):
            parts.append(_rod(pose, 1.3 * reach, thickness, colour))
        if board and anywhere:
            parts += self._board_parts(N @ board_pose(target))
        s = _SUBPIXELS
        out = np.full((s * height, s * width, 3), BACKGROUND_GREY, np.uint8)
        focal, middle = s * camera.focal * height, (0.5 * s * width - 0.5, 0.5 * s * height - 0.5)
        self._paint_shadows(out, shadows, camera, focal, middle)
        seen = Triangles(*(np.concatenate(part) for part in zip(*parts, strict=True)))
        seen = seen._replace(corners=(seen.corners - at) @ turn)
        paint_triangles(out, seen, focal, middle)
        return np.asarray(cv2.resize(out, (width, height), interpolation=cv2.INTER_AREA), np.uint8)

    def _paint_shadows(self, out, bodies, camera, focal, middle) -> None:
        mask = np.zeros(out.shape[:2], np.uint8)
        for vertices in bodies:
            above = np.maximum(vertices[:, 2:] - self._floor_m, 0.0)
            ground = vertices - above * np.array([0.25, -0.25, 1.0])
            seen = (ground - camera.pose[:3, 3]) @ camera.pose[:3, :3]
            if seen[:, 2].min() < 0.05:
                continue
            uv = focal * seen[:, :2] / seen[:, 2:] + middle
            if np.abs(uv).max() < 20000:
                cv2.fillConvexPoly(mask, cv2.convexHull(uv.round().astype(np.int32)), 255)
        if mask.any():
            mask = cv2.GaussianBlur(mask, (0, 0), 12)
            out[:] = (out * (1.0 - _SHADOW / 255.0 * mask[..., None])).astype(np.uint8)

    def _board_parts(self, pose) -> list[Triangles]:
        cells = self._board.cells
        rows, columns = cells.shape
        y, x = np.mgrid[:rows, :columns].reshape(2, -1)
        square = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], float)
        places = (np.stack([x, y], -1)[:, None] + square - self._board.origin_cells) * self._board.cell_m
        places = np.concatenate([places, np.zeros((*places.shape[:2], 1))], -1) @ pose[:3, :3].T + pose[:3, 3]
        front = places[:, [0, 2, 1, 0, 3, 2]].reshape(-1, 3, 3)
        grey = np.where(cells.ravel() > 127, 252.0, 35.0)
        colours = np.repeat(grey, 2)[:, None] * np.ones(3)
        whole = outline_m(self._board)
        back = np.column_stack([whole, np.full(4, 1e-3)]) @ pose[:3, :3].T + pose[:3, 3]
        ones = np.ones((len(front), 3))
        return [
            Triangles(front, ones, colours),
            Triangles(back[[[0, 1, 2], [0, 2, 3]]], np.ones((2, 3)), np.full((2, 3), 190.0)),
        ]


def _triangles(vertices, faces, shades, colour) -> Triangles:
    return Triangles(vertices[faces], shades[faces], np.tile(np.array(colour, float), (len(faces), 1)))


def _shade(normals):
    direct = np.maximum(normals @ _LIGHT, 0.0)
    return 0.55 + 0.15 * normals[..., 2] + 0.5 * direct


def _vertex_normals(vertices, faces):
    corners = vertices[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    out = np.zeros_like(vertices)
    for k in range(3):
        np.add.at(out, faces[:, k], normals)
    length = np.linalg.norm(out, axis=1, keepdims=True)
    return out / np.where(length > 0, length, 1.0)


def _rod(pose, length, radius, colour) -> Triangles:
    around = np.linspace(0.0, 2.0 * np.pi, _AXIS_SIDES, endpoint=False)
    ring = radius * np.column_stack([np.cos(around), np.sin(around), np.zeros(_AXIS_SIDES)])
    vertices = np.concatenate([ring, ring + [0.0, 0.0, length]]) @ pose[:3, :3].T + pose[:3, 3]
    a = np.arange(_AXIS_SIDES); b = (a + 1) % _AXIS_SIDES
    faces = np.concatenate([np.stack([a, b, b + _AXIS_SIDES], 1), np.stack([a, b + _AXIS_SIDES, a + _AXIS_SIDES], 1)])
    return _triangles(vertices, faces, np.ones(len(vertices)), colour)
