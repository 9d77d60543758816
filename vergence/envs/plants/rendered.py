"""The rendered plant: MuJoCo's dynamics, rendered images, and a real detector that reads them."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import ArrayLike

from vergence.envs.plant import TrialStart
from vergence.envs.plants.cameras import (
    TIME_TOLERANCE_S,
    BoardImageRenderer,
    Exposures,
    Frames,
    RoomImageRenderer,
    TrueHeadsAndTargets,
    draw_frame_faults,
    false_detection_offset,
    frame_arrival_time,
    image_displacement,
    outlier_offset,
    target_position_in_n,
    true_head_row,
)
from vergence.envs.plants.conditions import RANGES, PackedConditions, unpack_conditions
from vergence.envs.plants.mujoco import MujocoPlant
from vergence.envs.plants.step import (
    EXPOSE,
    MOVE,
    REPORT,
    STORE,
    WARM_UP,
    expose_frames_before_start,
)
from vergence.envs.reading import BoolArray, Image, Reading
from vergence.envs.reward import JUDGE, LIMIT
from vergence.envs.streams import Arrays, IntArray, StreamKey, StreamKeys, StreamPurpose
from vergence.envs.targets.motion import Board, board_axes, is_shown
from vergence.errors import ConfigurationError
from vergence.kernels import compiled
from vergence.models.camera import Camera
from vergence.models.head import HeadModel
from vergence.models.kinematics import direction_to_local, eye_frames, point_to_local
from vergence.models.parts import FloatArray
from vergence.vision.objects.faces import face_from_middle
from vergence.vision.objects.scenes import BORDER, Scene, parse_scene
from vergence.vision.objects.search import HeadSearch
from vergence.vision.objects.targets import (
    ColourTarget,
    FaceTarget,
    GazeTarget,
    OwnTarget,
    PlaceTarget,
    PointTarget,
    parse_gaze_target,
)
from vergence.vision.objects.walls import read_colours
from vergence.vision.targets import AprilTag, Checkerboard, make_planar_target


class RenderedPlant(MujocoPlant):
    """Heads whose eyes see rendered images, in which a detector finds the target.

    Detection noise is the detector's own; the preset's rendering sets the noise of the grey levels.
    A variation cannot draw detection noise, a skew of the eyes, or the head, whose lenses are
    prepared once for all images. Missed detections, outliers and false detections are added to the
    detector's own.

    Args:
        head: the model that a controller knows.
        num: number of heads.
        board: pattern of the target: `tag` (AprilTag 36h11) or `checkerboard`.
        facing: orientation of the board, `head` or `forward`, see `BoardImageRenderer`.
        width_rad: ratio of the board's width to its distance, see `BoardImageRenderer`.
        look: what the eyes look for in place of that board, see `parse_gaze_target`: a tag or a
            checkerboard of its own size, or an object, in a room.
        scene: the object in the room, see `parse_scene`; by default a ball for colours and one's
            own detectors, a poster for a point.
        wall: file of a photograph on the room's front wall; None for procedural texture.
        **options: options of `MujocoPlant`.

    Attributes:
        scene: the room; None for a board before plain grey.

    Raises:
        ConfigurationError: an option has an invalid value.
    """

    workspace_options: ClassVar[Mapping[str, Any]] = {"width_rad": "fit"}
    _varies: ClassVar[frozenset[str]] = frozenset(RANGES) - {"detection_noise_px", "skew_s"}

    def __init__(
        self, head: HeadModel, num: int = 1, *, board: Literal["tag", "checkerboard"] = "tag",
        facing: Literal["head", "forward"] = "head",
        width_rad: float | Literal["fit"] | None = None, look: str | None = None,
        scene: str | None = None, wall: str | None = None, **options: Any,
    ) -> None:  # fmt: skip
        super().__init__(head, num, **options)
        if self.conditions.skew_s.any():
            raise ConfigurationError(
                f"skew_s: expected 0, got {options['skew_s']!r:.80}; eyes that are not in step are "
                "what the plants kinematic and mujoco simulate"
            )
        target: GazeTarget = make_planar_target(board)
        shown = target
        if look is not None:
            target, width_rad = parse_gaze_target(look), None
        shown = AprilTag() if isinstance(target, PlaceTarget) else target
        true, many = self.true_head, bool(self.true_head.batch_shape)
        in_room = self.scene = scene_of(shown, scene, wall)
        self._views: list[BoardImageRenderer] = []
        for i in range(num):
            one = true[i % len(self.conditions.heads)] if many else true
            if in_room is not None:
                self._views.append(RoomImageRenderer(one, in_room, head))
            elif isinstance(shown, AprilTag | Checkerboard):
                self._views.append(
                    BoardImageRenderer(one, shown, width_rad=width_rad, facing=facing, model=head)
                )
            else:
                raise ConfigurationError(
                    f"look: expected a tag, a checkerboard or an object, got {target}"
                )
        self._searches = [HeadSearch(target, head) for _ in range(num)]
        self._keeps_images = in_room is not None  # while a detector is at work, or for both eyes
        # the target's own point, as somebody would click it
        self._unnamed_point = target == PointTarget()
        self._named = np.zeros(num, dtype=np.bool_)
        self._facing_head = facing == "head"
        self._T_C_T = np.empty((2, 4, 4))
        self._smear_px = np.empty((2, 2))
        self._found = np.zeros((*self._exposures.time_s.shape, 2, 2))
        self._seen = np.zeros((*self._exposures.time_s.shape, 2), dtype=np.bool_)
        self._answered = np.zeros(self._exposures.time_s.shape, dtype=np.bool_)

    @property
    def board(self) -> Board:
        """Shape of the targets, see `Plant.board`."""
        return self._views[0].board

    def frames(self, place: int = 0) -> tuple[Image, Image]:
        """See `Plant.frames`."""
        return self._views[place].frames

    def _arrays(self) -> Arrays:
        raise ConfigurationError(
            "state: expected the plant kinematic or mujoco, got rendered, "
            "whose detectors remember what they have seen"
        )

    def begin(self, start: TrialStart) -> Reading:
        """See `SimulatedPlant.begin`."""
        for env in start.ids.tolist():
            self._searches[env].forget()
            self._named[env] = False
        return super().begin(start)

    def _advance(self, ids: IntArray, phases: int) -> bool:
        packed = self._true_heads.packed
        while phases & WARM_UP and expose_frames_before_start(
            ids, packed, self._scene, self._frames, self._exposures
        ):
            self._advance(ids, EXPOSE)
        if not phases & EXPOSE:
            return super()._advance(ids, phases & ~WARM_UP)
        if not super()._advance(ids, phases & (LIMIT | STORE | MOVE)):
            return False
        for env in ids.tolist():
            count = int(self._exposures.counts[env])
            first = int(self._frames.next[env])
            for i in range(count):
                self._photograph(env, first + i, i)
        store_detections(
            ids, packed, self._streams.keys, self._exposures, self._frames, self._found,
            self._seen, self._answered,
        )  # fmt: skip
        return super()._advance(ids, phases & (REPORT | JUDGE))

    def _photograph(self, env: int, frame: int, i: int) -> None:
        """Take both eyes' frames of the period's i-th exposure, and keep the detections."""
        there = board_poses_in_cameras(
            env, i, 0.5 * self.head.timing.exposure_s, self._facing_head, self._scene,
            self._exposures, float(self.conditions.onset_s[env]), self._T_C_T, self._smear_px,
        )  # fmt: skip
        if not there:
            self._T_C_T[:, 2, 3] = -1.0  # behind the cameras, where nothing is visible
        # camera poses by the head model that a controller knows
        positions = self._exposures.positions[env, i]
        T_0_C = self.head.base_pose(positions) @ self.head.camera_poses(positions)
        # frames before time zero have the odd blocks, later ones the even blocks
        rng = self._streams.generator_at(
            env, StreamPurpose.IMAGE, 2 * frame if frame >= 0 else -2 * frame - 1
        )
        views, search = self._views[env], self._searches[env]
        views.room(positions, self._exposures.velocities[env, i])
        frames = views.draw_poses(self._T_C_T, rng, self._smear_px)
        time_s = float(self._exposures.time_s[env, i])
        begun = time_s >= float(self.conditions.onset_s[env])
        if self._unnamed_point and not self._named[env] and begun:
            self._named[env] = True
            search.shared.click(0, Camera.of(self.true_head, 0).project(self._T_C_T[:1, :3, 3])[0])
        for eye, own in enumerate(search.eyes):
            # plain background need not be searched
            image = frames[eye].copy() if self._keeps_images else frames[eye]
            own.look(image, T_0_C[eye], time_s, search=views.board_in_image[eye])
        found = [one.found() for one in search.eyes]
        # neither eye's: a slow detector has not answered yet
        self._answered[env, i] = any(one is not None for one in found)
        for eye, one in enumerate(found):
            self._seen[env, i, eye] = False
            if one is not None and one.detection is not None:
                self._found[env, i, eye], self._seen[env, i, eye] = one.detection.pixel, True

    def click(self, eye: int, pixel: ArrayLike, place: int = 0) -> FloatArray:
        """Follow the point of the room at a pixel of an eye's image, from the next image on.

        Args:
            eye: 0 for left, 1 for right.
            pixel: (2,) raw pixel (u, v).
            place: environment index.

        Returns:
            (3,) the point in the present N, m.

        Raises:
            ConfigurationError: the target is no point in a room, or `pixel` is no pixel.
        """
        self._searches[place].shared.click(eye, pixel)
        self._named[place] = True
        views = self._views[place]
        assert isinstance(views, RoomImageRenderer)  # as points are in rooms only
        return views.surface(self.truth().positions[place], eye, pixel)

    @property
    def remark(self) -> str:
        """See `Plant.remark`; that of the first head."""
        return self._searches[0].shared.remark

    def diagnostics(self) -> dict[str, int]:
        """Jumps to another object that were refused, if there were any."""
        refused = sum(search.shared.refused for search in self._searches)
        return {"jumps_refused": refused} if refused else {}

    def close(self) -> None:
        """See `Plant.close`."""
        for search in self._searches:
            search.shared.close()
        super().close()


def scene_of(target: GazeTarget, scene: str | None, wall: str | None) -> Scene | None:
    """The room in which a target is shown; None for printed ones before plain grey."""
    if not isinstance(target, ColourTarget | FaceTarget | PointTarget | OwnTarget):
        if scene is not None or wall is not None:
            raise ConfigurationError(
                f"scene: expected a target in a room, such as colour:#ff8000, got {target}"
            )
        return None
    if scene is None:
        if isinstance(target, FaceTarget):
            raise ConfigurationError(
                "scene: expected a printed face, poster:FILE, for a face to look at, got none"
            )
        rgb = target.rgb if isinstance(target, ColourTarget) else (255, 128, 0)
        ball = f"ball:#{bytes(rgb).hex()}"
        scene = "poster" if isinstance(target, PointTarget) else ball
    in_room = parse_scene(scene, wall)
    if isinstance(target, FaceTarget) and in_room.picture is not None:
        picture = read_colours(in_room.picture)
        inner_m = in_room.size_m * (1.0 - 2.0 * BORDER)
        off = face_from_middle(target, picture) * inner_m / picture.shape[1]
        in_room = replace(in_room, measured_m=tuple(off.tolist()))
    return in_room


@compiled
def store_detections(
    ids: IntArray, packed: PackedConditions, keys: StreamKeys, exposures: Exposures, frames: Frames,
    detections_px: FloatArray, detected: BoolArray, answered: BoolArray,
) -> None:  # fmt: skip
    """Store detections (n, E, 2, 2) in the frames' ring buffers.

    An image that is not `answered` (n, E) counts as dropped: nothing is known of it yet.
    """
    mask = frames.dropped.shape[1] - 1
    for n in ids:
        conditions, key = unpack_conditions(packed, n), StreamKey(keys.seeds[n], keys.trials[n])
        for i in range(exposures.counts[n]):
            f, time_s = frames.next[n], exposures.time_s[n, i]
            frames.next[n] = f + 1
            slot, faults = np.uintp(f & mask), draw_frame_faults(conditions, key, f)
            dropped = faults.dropped or not answered[n, i]
            frames.exposed_s[n, slot], frames.dropped[n, slot] = time_s, dropped
            if dropped:
                continue
            comes_s = frame_arrival_time(
                conditions, time_s, faults.extra_latency_s, frames.latest_s[n]
            )
            frames.comes_s[n, slot] = frames.latest_s[n] = comes_s
            for eye in range(2):
                missed = faults.missed_right if eye else faults.missed_left
                visible = detected[n, i, eye] and not missed
                frames.visible[n, slot, eye] = visible
                if visible:
                    du, dv = outlier_offset(conditions, key, f, eye)
                    false_u = false_v = 0.0
                    if conditions.false_detection_probability > 0.0:
                        false_u, false_v = false_detection_offset(conditions, key, f, eye)
                    frames.pixels[n, slot, eye, 0] = detections_px[n, i, eye, 0] + du + false_u
                    frames.pixels[n, slot, eye, 1] = detections_px[n, i, eye, 1] + dv + false_v


@compiled
def board_poses_in_cameras(
    env_index: int, exposure_index: int, half_exposure_s: float, board_faces_head: bool,
    scene: TrueHeadsAndTargets, exposures: Exposures, onset_s: float, T_C_T: FloatArray,
    smear_px: FloatArray,
) -> bool:  # fmt: skip
    """Compute the board's poses in both cameras, and the motion blur of its images, px.

    The result is True if there is a target at this time.
    """
    p, time_s = true_head_row(scene, env_index), exposures.time_s[env_index, exposure_index]
    q = exposures.positions[env_index, exposure_index]
    v = exposures.velocities[env_index, exposure_index]
    motion = scene.motions[env_index]
    target_time_s = time_s - onset_s + TIME_TOLERANCE_S
    x, y, z = target_position_in_n(p, motion, scene.necks[env_index], q, target_time_s)
    # columns of the board's rotation in N
    axes = board_axes((x, y, z), board_faces_head)
    for eye in range(2):
        camera = eye_frames(p, eye, q[3 + 2 * eye], q[4 + 2 * eye]).camera
        out = T_C_T[eye]
        for j in range(3):
            axis = axes[j]
            out[0, j], out[1, j], out[2, j] = direction_to_local(camera, axis[0], axis[1], axis[2])
        out[0, 3], out[1, 3], out[2, 3] = point_to_local(camera, x, y, z)
        out[3, 0] = out[3, 1] = out[3, 2] = 0.0
        out[3, 3] = 1.0
        du = dv = 0.0
        if half_exposure_s > 0.0:
            du, dv = image_displacement(
                p, motion, scene.necks[env_index], eye, q, v, target_time_s, half_exposure_s
            )
        smear_px[eye, 0], smear_px[eye, 1] = du if du == du else 0.0, dv if dv == dv else 0.0
    return is_shown(motion, target_time_s)
