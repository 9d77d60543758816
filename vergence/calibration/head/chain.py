r"""Projection of a board's corners through a moving head's kinematic chain, with exact Jacobians.

A corner x of a board in frame 0, the neck, an eye's joints and its camera form the chain

    p_C = (T_0_N(neck) M_0 RotZ(q1) M_1 RotZ(q2) M_2)^-1 T_0_B x.

Each estimated parameter moves the part of the chain from some frame F to the camera, by a twist
xi = (w, v), rotation first, expressed in F. This moves the corner in F by `-(w x p_F + v)`, so that
a pixel coordinate whose derivative by p_F is g_F changes by

    -(p_F x g_F, g_F) . xi .

So the Jacobians need only the rows `(p_F x g_F, g_F)`, called wrenches, in each frame F.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vergence.calibration.adjustment import BoardPoses, cross_matrices
from vergence.calibration.projection import camera_parameter_names, project_with_jacobians
from vergence.models.geometry import inverse_pose, pose_parameter_twists
from vergence.models.head import HeadModel
from vergence.models.parts import EYE_NAMES, FloatArray

IntArray = NDArray[np.intp]


class ProjectedBoard(NamedTuple):
    """Pixels of one eye in all frames, and their Jacobians."""

    pixels: FloatArray
    """(f, n, 2) px; nan behind the camera."""
    head_jacobian: FloatArray
    """(f, n, 2, p_eye) Jacobian by the head parameters that the eye depends on, see
    `ParametricHead.eye_parameter_indices`."""
    joint_jacobian: FloatArray
    """(f, n, 2, 7) Jacobian by the joint angles, px/rad."""
    board_jacobian: FloatArray
    """(f, n, 2, 6) Jacobian by a small rotation of the board in frame 0 and a translation, px/rad
    and px/m."""


@dataclass(frozen=True, eq=False)
class ParametricHead:
    """Chains of a head with (p,) `HeadModel.parameters` relative to the nominal head."""

    nominal_head: HeadModel
    values: FloatArray

    @cached_property
    def head(self) -> HeadModel:
        """The head with these parameters."""
        return self.nominal_head.with_parameters(self.values)

    @cached_property
    def constant_poses(self) -> FloatArray:
        """(10, 4, 4) B_0 to B_3 of the neck, and M_0 to M_2 of each eye with its camera."""
        poses = np.array(self.head.links.constant_poses())
        for eye in range(2):
            poses[6 + 3 * eye] = poses[6 + 3 * eye] @ self.head.head_eye[eye]
        return poses

    @cached_property
    def twists(self) -> FloatArray:
        """(p, 6, 6) body twists by parameter and constant: M_0 to M_2 of the left, then right."""
        links, nominal_head, head = self.head.links, self.nominal_head, self.head
        names = head.parameters().names
        out = np.zeros((len(names), 6, 6))
        own = links.twists(nominal_head.links)
        out[: len(own)] = own
        for eye, name in enumerate(EYE_NAMES):
            last = 3 * eye + 2
            into = adjoint(inverse_pose(head.head_eye[eye]))
            out[:, last] = out[:, last] @ into.T
            first = names.index(f"{name}.head_eye.rx")
            rotation = self.values[first : first + 3]
            out[first : first + 6, last] = pose_parameter_twists(
                nominal_head.head_eye[eye], rotation
            )
        return out

    @cached_property
    def eye_parameter_indices(self) -> tuple[IntArray, IntArray]:
        """(p_eye,) by eye: indices of the parameters that it depends on, its camera's last."""
        names = self.nominal_head.parameters().names
        found = []
        for eye, name in enumerate(EYE_NAMES):
            moved = self.twists[:, 3 * eye : 3 * eye + 3].any(axis=(1, 2))
            own = [names.index(f"{name}.camera.{each}") for each in self._camera(eye)]
            found.append(np.concatenate([np.flatnonzero(moved), own]).astype(np.intp))
        return found[0], found[1]

    def _camera(self, eye: int) -> tuple[str, ...]:
        return camera_parameter_names(self.nominal_head.cameras.lens[eye])

    def project_board(
        self, eye: int, q: FloatArray, points: FloatArray, offsets: FloatArray
    ) -> ProjectedBoard:
        """Project (f, n, 3) points in frame 0, m, at (f, 7) q; offsets are from the board's."""
        B, M = self.constant_poses[:4], self.constant_poses[4 + 3 * eye : 7 + 3 * eye]
        after = [(B[0], q[:, 0]), (B[1], q[:, 1]), (B[2], q[:, 2]), (B[3], None)]
        after += [(M[0], q[:, 3 + 2 * eye]), (M[1], q[:, 4 + 2 * eye]), (M[2], None)]
        # each frame after its joint's rotation: the joint's own twist is about its z axis
        places, rotations = [points], [np.broadcast_to(np.eye(3), (len(q), 3, 3))]
        inside, rotation = points, rotations[0]
        for constant, angle in after:
            inside = (inside - constant[:3, 3]) @ constant[:3, :3]
            rotation = rotation @ constant[:3, :3]
            if angle is not None:
                turn = rotations_about_z(angle)
                inside = inside @ turn
                rotation = rotation @ turn
            places.append(inside)
            rotations.append(rotation)
        lens = self.head.cameras.lens[eye]
        cameras = self.head.cameras
        own = self._camera(eye)
        values = np.concatenate(
            [cameras.focal[eye], cameras.principal[eye], cameras.distortion[eye][: len(own) - 4]]
        )
        image = project_with_jacobians(lens, values, inside)
        in_base = image.point_jacobian @ rotation.transpose(0, 2, 1)[:, None]

        def wrench(place: int) -> FloatArray:
            gradient = in_base @ rotations[place][:, None]
            return np.concatenate([_cross(places[place], gradient), gradient], axis=-1)

        columns = self.eye_parameter_indices[eye]
        twists = self.twists[columns, 3 * eye : 3 * eye + 3]
        by_head = np.zeros((*image.pixels.shape, len(columns)))
        for k, place in enumerate((5, 6, 7)):
            used = np.flatnonzero(twists[:, k].any(axis=1))
            rows = wrench(place)
            if k < 2:  # the constant comes before its joint's rotation
                rows = _turned(rows, rotations_about_z(-q[:, 3 + 2 * eye + k]))
            by_head[..., used] -= rows @ twists[used, k].T
        by_head[..., -len(own) :] = image.camera_jacobian
        by_joints = np.zeros((*image.pixels.shape, 7))
        for joint, place in ((0, 1), (1, 2), (2, 3), (3 + 2 * eye, 5), (4 + 2 * eye, 6)):
            gradient = in_base @ rotations[place][:, None]
            x, y = places[place][..., 0], places[place][..., 1]
            by_joints[..., joint] = -(
                x[..., None] * gradient[..., 1] - y[..., None] * gradient[..., 0]
            )
        by_board = np.concatenate([_cross(offsets, in_base), in_base], axis=-1)
        return ProjectedBoard(image.pixels, by_head, by_joints, by_board)


def rotations_about_z(angle: FloatArray) -> FloatArray:
    """(f, 3, 3) rotations about z."""
    c, s = np.cos(angle), np.sin(angle)
    zero, one = np.zeros_like(c), np.ones_like(c)
    return np.stack([c, -s, zero, s, c, zero, zero, zero, one], axis=-1).reshape(-1, 3, 3)


def adjoint(pose: FloatArray) -> FloatArray:
    """(6, 6) adjoint matrix of the pose T_A_B: transforms a twist from frame B to frame A."""
    out = np.zeros((6, 6))
    out[:3, :3] = out[3:, 3:] = pose[:3, :3]
    out[3:, :3] = cross_matrices(pose[:3, 3]) @ pose[:3, :3]
    return out


def board_points_and_offsets(
    corners: FloatArray, boards: BoardPoses, pose_index: IntArray
) -> tuple[FloatArray, ...]:
    """Corners (n, 3) of boards in frame 0, m, and offsets from each board's origin, by frame."""
    turned = corners @ boards.rotation[pose_index].transpose(0, 2, 1)
    return turned + boards.translation[pose_index][:, None], turned


def _cross(points: FloatArray, gradients: FloatArray) -> FloatArray:
    """(f, n, 2, 3) cross products of points (f, n, 3) and gradients (f, n, 2, 3)."""
    return np.cross(points[:, :, None], gradients)


def _turned(wrench: FloatArray, turn: FloatArray) -> FloatArray:
    """Express both halves of rows (f, n, 2, 6) in a frame rotated by (f, 3, 3)."""
    halves = wrench.reshape(*wrench.shape[:-1], 2, 3) @ turn[:, None, None]
    return halves.reshape(wrench.shape)
