"""The head, its target and its optical axes from outside, drawn by MuJoCo."""

from typing import Final

import mujoco
import numpy as np

from vergence.envs.reading import Image
from vergence.models.boards import board_pose, make_planar_target
from vergence.models.head import HeadModel
from vergence.models.links import inverse_pose
from vergence.models.mujoco.model import compile_model, find_model_indices
from vergence.models.mujoco.posture import rest_poses
from vergence.models.parts import FloatArray
from vergence.viewer.eye_pictures import EYE_COLOURS

_MAX_NARROW_BASELINE_M: Final = 0.15
"""Baseline above which the camera moves back to keep the head in view, m (chosen: room around wide
heads against the size of the picture)."""


class OutsideView:
    """The head from outside, drawn by MuJoCo."""

    def __init__(self, head: HeadModel) -> None:
        self._model = compile_model(head, target="tag", board=make_planar_target("tag"))
        self._data = mujoco.MjData(self._model)
        self._board = self._model.geom_bodyid == self._model.body("tag").id
        self._head = head
        self._places = find_model_indices(self._model, head).joint_of_qpos
        posture = rest_poses(head)
        self._upright, self._width_m = posture.upright_frame, posture.baseline_m
        self._renderer: mujoco.Renderer | None = None

    def draw(
        self,
        positions: FloatArray,
        target: FloatArray,
        width: int,
        height: int,
        *,
        board: bool = True,
    ) -> Image:
        """Draw the head.

        Args:
            positions: (7,) joint angles, rad.
            target: (3,) point to keep in view, in N, m; nan for none.
            width: px.
            height: px.
            board: True to draw the target's board; in front of a robot it is not known.

        Returns:
            (height, width, 3) RGB.
        """
        if self._renderer is None:
            self._model.vis.global_.offwidth = max(width, self._model.vis.global_.offwidth)
            self._model.vis.global_.offheight = max(height, self._model.vis.global_.offheight)
            self._renderer = mujoco.Renderer(self._model, height, width)
        self._data.qpos[: len(self._places)] = positions[self._places]
        there = board and bool(np.isfinite(target).all())
        self._model.geom_rgba[self._board, 3] = float(there)
        if there:
            pose = self._head.base_pose(positions) @ board_pose(target)
            self._data.mocap_pos[0] = pose[:3, 3]
            mujoco.mju_mat2Quat(self._data.mocap_quat[0], pose[:3, :3].ravel())
        mujoco.mj_forward(self._model, self._data)
        base_pose = self._head.base_pose(positions)
        seen_from = place_outside_camera(
            inverse_pose(self._upright) @ base_pose, target, self._width_m
        )
        self._renderer.update_scene(self._data, seen_from)
        self._turn_upright()
        self._add_axes(base_pose, positions, target)
        return np.asarray(self._renderer.render())

    def _turn_upright(self) -> None:
        """Move camera and headlight from upright to model frame: MuJoCo takes z for up."""
        assert self._renderer is not None
        if np.array_equal(self._upright, np.eye(4)):
            return
        scene, turn, origin = self._renderer.scene, self._upright[:3, :3], self._upright[:3, 3]
        for camera in scene.camera:
            camera.pos = turn @ camera.pos + origin
            camera.forward, camera.up = turn @ camera.forward, turn @ camera.up
        for light in list(scene.lights)[: scene.nlight]:
            if light.headlight:
                light.pos, light.dir = turn @ light.pos + origin, turn @ light.dir

    def _add_axes(self, base_pose: FloatArray, positions: FloatArray, target: FloatArray) -> None:
        """Draw the optical axes of both eyes, to 1.1 times the target's distance."""
        assert self._renderer is not None
        scene, reach = self._renderer.scene, 1.1 * _reach(target)
        for pose, colour in zip(
            base_pose @ self._head.camera_poses(positions), EYE_COLOURS, strict=True
        ):
            geom = scene.geoms[scene.ngeom]
            scene.ngeom += 1
            rgba = np.array([*(np.array(colour) / 255.0), 1.0], dtype=np.float32)
            kind = mujoco.mjtGeom.mjGEOM_CAPSULE
            mujoco.mjv_initGeom(geom, kind, np.zeros(3), np.zeros(3), np.zeros(9), rgba)
            geom.emission = 0.6
            begin, end = pose[:3, 3], pose[:3, 3] + reach * pose[:3, 2]
            mujoco.mjv_connector(geom, kind, 0.0015 + 0.0015 * reach, begin, end)

    def close(self) -> None:
        """Release OpenGL's context."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None


def place_outside_camera(
    base_pose: FloatArray, target: FloatArray, baseline_m: float = 0.0
) -> mujoco.MjvCamera:
    """Place a camera behind the right shoulder, with both the head and the target in view.

    Args:
        base_pose: (4, 4) present pose of N, which the neck moves, in the head's upright frame.
        target: (3,) in N, m; nan for none.
        baseline_m: baseline of the eyes, m.
    """
    camera, reach = mujoco.MjvCamera(), _reach(target)
    towards = target if np.isfinite(target).all() else np.array([0.0, 0.0, reach])
    camera.lookat = (base_pose @ [*(0.5 * towards), 1.0])[:3]
    camera.distance = 0.35 + 1.35 * reach + 1.5 * max(0.0, baseline_m - _MAX_NARROW_BASELINE_M)
    camera.azimuth, camera.elevation = -145.0, -22.0
    return camera


def _reach(target: FloatArray) -> float:
    """Distance of the target from N's origin, m; 0.5 m without a target."""
    return float(np.linalg.norm(target)) if np.isfinite(target).all() else 0.5
