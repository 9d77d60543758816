"""A head in 3D in the browser: links, eyes, optical axes, target, and the fix by gaze."""

from collections.abc import Callable, Sequence
from typing import Final

import numpy as np
import viser
from scipy.spatial.transform import Rotation

from vergence.envs.reading import Image
from vergence.models.geometry import inverse_pose
from vergence.models.head import HeadModel
from vergence.models.parts import EYE_NAMES, FloatArray
from vergence.models.posture import rest_poses
from vergence.viewer.eye_pictures import BACKGROUND_GREY, EYE_COLOURS, FIX_COLOUR, TARGET_COLOUR
from vergence.viewer.moment import Moment
from vergence.viewer.shapes import HeadShapes
from vergence.vision.objects.room import print_poster
from vergence.vision.objects.scenes import Scene, poster_size_m
from vergence.vision.objects.walls import HIGH_M, LOW_M, front_wall
from vergence.vision.targets import board_pose, make_planar_target, outline_m, texture

_GAP_COLOUR: Final = (200, 30, 30)
"""RGB of the common perpendicular, 0 to 255 (chosen: unlike the eyes\' colours)."""
_FRUSTUM_BASELINES: Final = 0.35
"""Length of an eye's frustum in baselines (chosen: visible against the eyes, short of the
target)."""
_MAX_FRUSTUM_RAD: Final = 2.4
"""Widest drawn field of view, rad (chosen: a wider frustum would be flat)."""
_BOARD_PX_PER_CELL: Final = 16
"""Pixels of the target's picture along a cell (chosen: sharp edges)."""
_OBJECT_M: Final = 0.02
"""Radius of a target that is no tag, m (chosen: legible beside the fix's ellipsoid)."""
_WALL_PX_M: Final = 150.0
"""Pixels of the room's wall for each metre (chosen: detail against time)."""
_CAMERA_OFFSET: Final = (0.85, 0.6, 0.45)
"""First place of the page's camera from the middle between head and target, by their distance
(chosen: both are in view, the eyes from beside)."""
_LOWER: Final = 0.5
"""Height by which the camera looks too low on a page half as wide as high, by the camera's distance
(chosen: head and target are in the upper half)."""
# least and greatest distance of a target that the page's first view takes in, m (chosen: around
# arm's length)
_MIN_VIEW_M: Final = 0.7
_MAX_VIEW_M: Final = 2.5
_DISTANCE_WITHOUT_FIX_M: Final = 1.0
"""Length of the optical axes without a fix, m (chosen: an arm's length and more)."""


OnLook = Callable[[int, FloatArray], None]
_SCREEN_SHARE: Final = 0.24
"""Width of an eye's image above the head by the distance of the page's first camera (chosen: fine
enough to be clicked in, in view with the head)."""
_SCREEN_SPACING: Final = 1.06
"""Distance of both images' middles, in widths (chosen: looks)."""
_SCREEN_HEIGHT_M: Final = 0.22
"""Height of their lower edges above the head's origin, m (chosen: above every preset)."""


class HeadScene:
    """The scene of one head, in the head's upright frame: z up, the head looks along -y.

    Args:
        server: server of the browsers.
        head: one head, not a population.
        on_look: called with an eye, 0 for left, and a raw pixel (u, v), shape (2,), that somebody
            has clicked in the eye's image, which then hangs above the head; None for no images.
        room: the room, whose front wall and thing are shown; None for none.

    Attributes:
        target: the handles by which the target can be dragged, hidden at first.
    """

    def __init__(
        self, server: viser.ViserServer, head: HeadModel, on_look: OnLook | None = None,
        room: Scene | None = None,
    ) -> None:  # fmt: skip
        self._server, self._head = server, head
        self._shapes = HeadShapes(head)
        self._N = np.eye(4)
        api = server.scene
        api.add_frame("/head", show_axes=False)
        self._bodies: dict[int, viser.FrameHandle] = {}
        for number, mesh in enumerate(self._shapes.meshes):
            if mesh.body not in self._bodies:
                name = f"/head/body{mesh.body}"
                self._bodies[mesh.body] = api.add_frame(name, show_axes=False)
            api.add_mesh_simple(
                f"/head/body{mesh.body}/mesh{number}", mesh.vertices, mesh.faces, color=mesh.colour
            )
        reach = _FRUSTUM_BASELINES * self._shapes.baseline_m
        self._eyes = [
            api.add_camera_frustum(
                f"/head/{name}",
                fov=min(2.0 * np.arctan(0.5 * size[1] / focal[1]), _MAX_FRUSTUM_RAD),
                aspect=float(size[0] / size[1]),
                scale=reach,
                color=colour,
                thickness=1.5,
                thickness_units="screen",
                cast_shadow=False,
                receive_shadow=False,
            )
            for name, size, focal, colour in zip(
                EYE_NAMES, head.cameras.size, head.cameras.focal, EYE_COLOURS, strict=True
            )
        ]
        nothing = np.zeros((1, 2, 3))
        self._axes = [
            api.add_line_segments(
                f"/head/axis_{name}", nothing, colour, thickness=3.0, thickness_units="screen"
            )
            for name, colour in zip(EYE_NAMES, EYE_COLOURS, strict=True)
        ]
        self._perpendicular = api.add_line_segments(
            "/head/perpendicular", nothing, _GAP_COLOUR, thickness=5.0, thickness_units="screen"
        )
        self._fix = api.add_icosphere(
            "/head/fix", radius=1.0, color=FIX_COLOUR, opacity=0.45, cast_shadow=False
        )
        board = make_planar_target("tag")
        size = np.ptp(outline_m(board), axis=0)
        self._board = api.add_image(
            "/head/board",
            np.repeat(texture(board, _BOARD_PX_PER_CELL)[..., None], 3, axis=2),
            *size.tolist(),
            cast_shadow=False,
        )
        self._object = self._thing(room)
        self._off_m = np.zeros(2) if room is None else -np.array(room.measured_m)
        self.target = api.add_transform_controls(
            "/head/target", scale=0.18, disable_rotations=True, visible=False, line_width=3.0
        )
        self._screens = [] if on_look is None else [self._screen(eye, on_look) for eye in range(2)]
        self._camera_placed = False
        floor_m = rest_poses(head).floor_m
        if room is not None:
            self._add_wall(room)
        api.add_grid(
            "/floor", 4.0, 4.0, cell_size=0.1, section_size=0.5, position=(0.0, -1.0, floor_m),
            cell_color=(225, 225, 225), section_color=(200, 200, 200),
        )  # fmt: skip

    def _thing(self, room: Scene | None) -> viser.SceneNodeHandle:
        """What stands at the target's place, where it is no tag."""
        api = self._server.scene
        if room is None or room.thing == "nothing":
            return api.add_icosphere("/head/object", radius=_OBJECT_M, color=TARGET_COLOUR)
        if room.thing == "ball":
            return api.add_icosphere("/head/object", radius=0.5 * room.size_m, color=room.colour)
        poster = print_poster(room)[..., ::-1]
        return api.add_image("/head/object", poster, *poster_size_m(room), cast_shadow=False)

    def _add_wall(self, room: Scene) -> None:
        """Show the room's front wall, which stands before the head at rest."""
        T_head_wall = self._shapes.pose_of_n(self._head.rest())
        middle = T_head_wall @ [*(0.5 * (LOW_M + HIGH_M))[:2], HIGH_M[2], 1.0]
        self._server.scene.add_image(
            "/head/wall", front_wall(room.wall, _WALL_PX_M)[..., ::-1],
            *(HIGH_M - LOW_M)[:2].tolist(), format="jpeg", cast_shadow=False,
            receive_shadow=False, position=middle[:3], wxyz=_wxyz(T_head_wall[:3, :3]),
        )  # fmt: skip

    def _screen(self, eye: int, on_look: OnLook) -> viser.ImageHandle:
        """An eye's image above the head, facing the page's first camera, that can be clicked."""
        size = self._head.cameras.size[eye]
        away = -np.array(_CAMERA_OFFSET) / np.linalg.norm(_CAMERA_OFFSET)
        right = np.cross(away, [0.0, 0.0, 1.0])
        right /= np.linalg.norm(right)
        turn = np.column_stack([right, np.cross(away, right), away])
        node = self._server.scene.add_image(
            f"/head/screen_{EYE_NAMES[eye]}", np.full((2, 2, 3), BACKGROUND_GREY, np.uint8),
            1.0, 1.0, format="jpeg", cast_shadow=False, receive_shadow=False, visible=False,
            wxyz=_wxyz(turn),
        )  # fmt: skip

        @node.on_click
        def look(event: "viser.SceneNodePointerEvent[viser.ImageHandle]") -> None:
            start = turn.T @ (np.array(event.ray_origin) - node.position)
            along = turn.T @ np.array(event.ray_direction)
            place = (start - start[2] / along[2] * along)[:2]
            share = place / [node.render_width, node.render_height] + 0.5
            on_look(eye, share * size - 0.5)

        return node

    def _place_screens(self, away_m: float) -> None:
        """Hang the eyes' images above the head, as large as the page's camera is far away."""
        for eye, node in enumerate(self._screens):
            width, height = self._head.cameras.size[eye].tolist()
            size = _SCREEN_SHARE * away_m * np.array([1.0, height / width])
            right = Rotation.from_quat(node.wxyz, scalar_first=True).as_matrix()[:, 0]
            above = [0.0, 0.0, _SCREEN_HEIGHT_M + 0.5 * size[1]]
            node.render_width, node.render_height = size.tolist()
            node.position = (eye - 1.0) * _SCREEN_SPACING * size[0] * right + above
            node.visible = True

    def show_screens(self, images: Sequence[Image]) -> None:
        """Show both eyes' pictures, (height, width, 3) RGB, where they can be clicked."""
        for node, image in zip(self._screens, images, strict=False):
            node.image = image

    def point_in_n(self, point: FloatArray) -> FloatArray:
        """Convert a point of the scene to N as it was shown last.

        Args:
            point: (3,) in the upright frame, m.

        Returns:
            (3,) in N, m.
        """
        return np.asarray((inverse_pose(self._N) @ [*point, 1.0])[:3])

    def show(self, shown: Moment, *, sigmas: float, moves_target: bool = True) -> None:
        """Show a moment.

        Args:
            shown: the moment.
            sigmas: size of the covariance ellipsoid, in standard deviations.
            moves_target: False while somebody drags the target, so that it stays in their hand.
        """
        self._N = self._shapes.pose_of_n(shown.positions)
        poses = self._shapes.body_poses(shown.positions)
        cameras = self._N @ self._head.camera_poses(shown.positions)
        points = (self._N @ np.append(shown.fix.point, 1.0))[:3]
        with self._server.atomic():
            placed = np.concatenate([poses[list(self._bodies)], cameras])
            turns = _wxyz(placed[:, :3, :3])
            for node, pose, turn in zip(
                [*self._bodies.values(), *self._eyes], placed, turns, strict=True
            ):
                node.position, node.wxyz = pose[:3, 3], turn
            self._show_axes(cameras, points)
            valid = bool(shown.fix.valid)
            self._fix.visible = valid
            if valid:
                size, turn = np.linalg.eigh(shown.fix.covariance)
                if np.linalg.det(turn) < 0.0:
                    turn[:, 0] *= -1.0
                scale = sigmas * np.sqrt(np.maximum(size, 0.0))
                self._fix.scale = tuple(np.maximum(scale, 1e-4).tolist())
                self._fix.position = points
                self._fix.wxyz = _wxyz(self._N[:3, :3] @ turn)
            there = bool(np.isfinite(shown.target).all())
            if there and not self._camera_placed:
                self._place_camera((self._N @ [*shown.target, 1.0])[:3])
            self._board.visible = there and shown.shows_tag
            self._object.visible = there and shown.target_is_truth and not shown.shows_tag
            if there:
                pose = self._N @ board_pose(shown.target)
                self._board.position, self._board.wxyz = pose[:3, 3], _wxyz(pose[:3, :3])
                place = pose @ [*self._off_m, 0.0, 1.0]
                self._object.position, self._object.wxyz = place[:3], self._board.wxyz
                if moves_target:
                    self.target.position = pose[:3, 3]

    def _place_camera(self, target: FloatArray) -> None:
        """Place the page's first camera so that it sees the head, from beside, and the target."""
        self._camera_placed = True
        reach = target - self._N[:3, 3]
        size = max(float(np.linalg.norm(reach)), _MIN_VIEW_M + 2.0 * self._shapes.baseline_m)
        if size > _MAX_VIEW_M:
            reach, size = reach * (_MAX_VIEW_M / size), _MAX_VIEW_M
        self._place_screens(size)
        middle = self._N[:3, 3] + 0.35 * reach
        self._look_at, self._away = middle, size * np.array(_CAMERA_OFFSET)
        self._server.initial_camera.look_at = middle
        self._server.initial_camera.position = middle + self._away
        for client in self._server.get_clients().values():
            self.frame(client)

    def frame(self, client: viser.ClientHandle) -> None:
        """Have a browser look at the head and its target, from farther away if it is narrow."""
        if self._camera_placed:
            farther = max(1.0, 1.0 / client.camera.aspect)
            # on a narrow page controls cover the lower half
            below = (farther - 1.0) * _LOWER * np.linalg.norm(self._away)
            middle = self._look_at - [0.0, 0.0, below]
            client.camera.position = middle + farther * self._away
            client.camera.look_at = middle  # last: a new position moves it along

    def _show_axes(self, cameras: FloatArray, fix: FloatArray) -> None:
        """Draw the optical axes to beyond the fix, and their common perpendicular."""
        origins, directions = cameras[:, :3, 3], cameras[:, :3, 2]
        length = _DISTANCE_WITHOUT_FIX_M
        feet = None
        if np.isfinite(fix).all():
            length = float(np.linalg.norm(fix - origins.mean(axis=0)))
            along = np.einsum("ei,ei->e", fix - origins, directions)
            feet = origins + along[:, None] * directions
        for line, origin, direction in zip(self._axes, origins, directions, strict=True):
            line.points = np.array([[origin, origin + 1.15 * length * direction]], np.float32)
        self._perpendicular.visible = feet is not None
        if feet is not None:
            self._perpendicular.points = feet[None].astype(np.float32)


def _wxyz(turn: FloatArray) -> FloatArray:
    """Quaternions (..., 4) in the order w, x, y, z of rotation matrices (..., 3, 3)."""
    return np.asarray(Rotation.from_matrix(turn).as_quat(scalar_first=True))
