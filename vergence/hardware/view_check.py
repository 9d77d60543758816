"""Comparison of what the images do while single joints turn with what the configuration says.

Encoders cannot tell a wrong sign, exchanged ids or exchanged cameras: commands and angles are wrong
alike. So before the first gaze each joint turns by 0.1 rad with the target in view. Between two
postures at rest the target's pixel has to move as the head's model moves it, up to the errors of a
head that nobody has calibrated. If it does not, each possible mistake is applied to the angles and
the pixels; the one that explains the images is named. A wrong zero does not change how the images
move: it shows in lines of sight that miss each other, or in a distance that the target's size
contradicts.
"""

from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import combinations, product
from typing import Final, NamedTuple

import numpy as np
from scipy.optimize import least_squares

from vergence.envs.reading import Image
from vergence.errors import Finding
from vergence.hardware.approach import PROOF_RAD, PROOF_TIMEOUT_S, GoalNotReachedError, drive_to
from vergence.hardware.config import HardwareConfig
from vergence.hardware.servos import JointAngles, ServoConfig
from vergence.models.camera import Camera
from vergence.models.head import HeadModel
from vergence.models.parts import EYE_NAMES, NECK, FloatArray
from vergence.vision.detection import BoardDetection, Detection
from vergence.vision.objects.targets import GazeTarget, PointTarget
from vergence.vision.targets import AprilTag, PlanarTarget, TagFamily
from vergence.vision.tracking import make_detector

_DISTANCES_M: Final = (0.2, 0.35, 0.6, 1.0, 2.0, 4.0)
"""Distances of the target that are tried, m: they hardly change how its pixel moves (chosen)."""
_STEP_TOLERANCE: Final = 0.35
"""Accepted error of a pixel's motion, as a fraction of the expected motion (chosen: twice what an
uncalibrated focal length and a camera mounted by eye cause)."""
_STEP_TOLERANCE_RAD: Final = 0.012
"""Error accepted in addition, rad (chosen: a joint's play, and the target's unknown distance)."""
_SCALES: Final = (0.25, 1.0 / 3.0, 0.5, 2.0 / 3.0, 1.5, 2.0, 3.0, 4.0)
"""Ratios that are tried for a gear or a focal length (chosen)."""
_EQUAL_COST: Final = 2.0
"""Ratio of squared errors up to which two explanations are both named (chosen)."""
_SPEED_RATIO: Final = (0.6, 1.6)
"""Accepted ratios of a joint's motion to its commands, and of reported speeds to motion (chosen:
friction may take a third of a slow command)."""
_MOST_PERIODS: Final = 3.0
"""Control periods after which a command that is late is no longer repeated (numerical: as in
`vergence.hardware.drive`)."""
_AHEAD_M: Final = 1.0
"""Distance at which an emulated head's target stands for the check, m (chosen)."""
_LEAST_TURN_RAD: Final = 0.03
"""Least motion of a joint that is judged, rad (chosen: 20 steps of an encoder of 4,096)."""
_ZERO_SIGMA_RAD: Final = 0.02
"""Standard deviation of zeros and mounts set by eye, rad (chosen)."""
_SIZE_SIGMA: Final = 0.15
"""Standard deviation of a distance from the target's size, as a fraction: a tilted target, an
uncalibrated focal length (chosen)."""
_MAX_CHI2: Final = 9.0
"""Sum of squares in these sigmas above which a zero is wrong (chosen: 0.085 rad of a tilt)."""
_REFUSED_ZERO_RAD: Final = 0.12
"""Error of a zero above which the head must not move; below it is told, rad (chosen)."""


_VIEW_CURE: Final = (
    "put it about 1 m ahead of the head at rest, in good light, in view of both eyes; to move "
    "without this check: --no-view-check"
)
_POINT_CURE: Final = (
    "name another pixel, of something with texture at least 0.5 m away that both eyes see; to move "
    "without this check: --no-view-check"
)
_FLIP_CURE: Final = "turn the camera, or switch its flip off"


class Posture(NamedTuple):
    """A posture at rest, and the target in both eyes."""

    angles: FloatArray
    """(7,) angles of neck and actuators, as reported, rad."""
    pixels: FloatArray
    """(2, 2) pixels of the target by eye; nan where it was not found."""
    ranges_m: FloatArray
    """(2,) distances from the eyes by the target's size, m; nan if unknown."""


class Turn(NamedTuple):
    """Motion of one joint between two postures."""

    servo: ServoConfig
    commanded_rad: float  # integral of the commands
    reported_rad: float  # integral of the reported speeds
    moved_rad: float  # change of the reported angle


class _Explanation(NamedTuple):
    """A mistake that may explain the images, and what it makes of angles and pixels."""

    finding: Finding
    turns: FloatArray = np.eye(7)
    """(7, 7) true angles by reported ones."""
    pixels: Callable[[FloatArray], FloatArray] = lambda pixels: pixels


def point_ahead(head: HeadModel, q: FloatArray) -> FloatArray:
    """(3,) point in N straight ahead of both eyes at joint angles, (7,) rad, at `_AHEAD_M`."""
    T_N_C = head.camera_poses(q)
    axis = T_N_C[:, :3, 2].mean(axis=0)
    return np.asarray(T_N_C[:, :3, 3].mean(axis=0) + _AHEAD_M * axis / np.linalg.norm(axis))


def compile_view_check(config: HardwareConfig) -> None:
    """Call every kernel of the check once, since none may be compiled while joints hold."""
    head = config.head
    q = head.rest()
    shown = head.project(q, point_ahead(head, q))
    seen = Posture(head.actuation.actuators_of(q), shown, np.full(2, np.nan))
    ViewCheck(config, [seen, seen], [Turn(config.servos[0], 0.1, 0.1, 0.1)]).findings(
        config.target, None
    )
    head.undistort(np.repeat(seen.pixels[:, np.newaxis], 2, axis=1))


def range_by_size(head: HeadModel, eye: int, found: BoardDetection | Detection) -> float:
    """Distance of a target that an eye, 0 for left, detected, by its size, m; nan if unknown."""
    if not isinstance(found, BoardDetection) or not found.target.size_known:
        return float("nan")
    raw = np.repeat(found.corners_px[:, np.newaxis], 2, axis=1)
    rays = (head.undistort(raw)[:, eye] - head.cameras.principal[eye]) / head.cameras.focal[eye]
    corners = np.asarray(found.target.corners_m)[:, :2]
    there = np.isfinite(rays).all(axis=-1)
    size, seen = (
        np.linalg.norm(part[there] - part[there].mean(axis=0)) for part in (corners, rays)
    )
    return float(size / seen)


def turn_each_joint(
    config: HardwareConfig,
    angles: JointAngles,
    send_velocities: Callable[[FloatArray], float],
    last_sent: Callable[[], FloatArray],
    look: Callable[[float], tuple[FloatArray, FloatArray]],
) -> "ViewCheck":
    """Turn one joint after the other by 0.1 rad, and look at the target between the turns.

    `send_velocities` updates the present `angles` of the servos, see `drive_to`; `last_sent` is
    what it sent last, (7,) rad/s. `look` returns `pixels` and `ranges_m` of a `Posture` from images
    after a time, s.
    """
    check = ViewCheck(config)
    rows: list[tuple[float, FloatArray, FloatArray]] = []

    def send(requested: FloatArray) -> float:
        now_s = send_velocities(requested)
        rows.append((now_s, last_sent().copy(), angles.speeds.copy()))
        return now_s

    def keep(rested_s: float) -> None:
        check.postures.append(Posture(angles.angles.copy(), *look(rested_s)))

    keep(send(np.zeros(7)))
    goal, middle = angles.angles.copy(), 0.5 * (angles.lower + angles.upper)
    period_s = config.head.timing.period_s

    def turn(servo: ServoConfig) -> None:
        slot, before = servo.slot, float(angles.angles[servo.slot])
        goal[slot] += PROOF_RAD if goal[slot] <= middle[slot] else -PROOF_RAD
        rows.clear()
        rested_s = np.nan
        with suppress(GoalNotReachedError):  # for example if a forbidden posture is in the way
            rested_s = drive_to(goal, config, angles, send, timeout_s=PROOF_TIMEOUT_S)
        times = np.array([row[0] for row in rows])
        speeds = np.array([(sent[slot], told[slot]) for _, sent, told in rows])
        # a command that is late by more is replaced by rest
        passed_s = np.minimum(np.diff(times, prepend=times[0]), _MOST_PERIODS * period_s)
        commanded_rad, reported_rad = (passed_s @ speeds).tolist()
        moved_rad = float(angles.angles[slot]) - before
        check.turns.append(Turn(servo, commanded_rad, reported_rad, moved_rad))
        keep(rested_s)

    for servo in config.servos:
        turn(servo)
        if any(_speeds(check.turns[-1])):  # again: a busy machine may have been late
            turn(servo)
    return check


@dataclass
class ViewCheck:
    """Postures and turns of single joints, and the judgement of them."""

    config: HardwareConfig
    postures: list[Posture] = field(default_factory=list)
    """Postures, each reached from the one before by the turn of one joint."""
    turns: list[Turn] = field(default_factory=list)
    """These turns."""

    def findings(
        self, target: GazeTarget, images: tuple[Image, Image] | None, remark: str = ""
    ) -> list[Finding]:
        """All mistakes, each named by its likeliest cause; empty for a head that is right.

        In the newest images of both eyes, if there are any, a target that was not found is looked
        for mirrored; `remark` says why an eye has not seen it, see `Plant.remark`.
        """
        last = {turn.servo.name: turn for turn in self.turns}
        found = [finding for turn in last.values() for finding in _speeds(turn)]
        found = found or self._unseen(target, images, remark)
        if found:
            return found
        angles = np.array([posture.angles for posture in self.postures])
        pixels = np.array([posture.pixels for posture in self.postures])
        if self._cost(angles, pixels)[1]:
            return self._zeros()
        return [self._explained(angles, pixels)]

    def _unseen(
        self, target: GazeTarget, images: tuple[Image, Image] | None, remark: str
    ) -> list[Finding]:
        """Findings of eyes that have never seen the target."""
        seen = np.array([np.isfinite(posture.pixels).all(axis=-1) for posture in self.postures])
        found, blind = [], np.flatnonzero(~seen.any(axis=0)).tolist()
        parts = [camera.name for camera in self.config.cameras]
        for eye in blind:
            if images is None or not isinstance(target, PlanarTarget | TagFamily):
                continue
            detector = make_detector(target, Camera.of(self.config.head, eye))
            if detector.detect(images[eye][:, ::-1].copy()) is not None:
                problem = f"expected images as the eye sees {target}, got mirrored ones"
                found.append(_finding(parts[eye], problem, _FLIP_CURE))
        if found or not blind:
            return found
        part, eye = "view", blind[0]
        why = f" ({remark})" if remark else ""
        problem = "of the head at the start, got images without it from both cameras"
        if seen.any():
            part, other = parts[eye], EYE_NAMES[1 - eye]
            problem = f"of both eyes at the start, got images without it: the {other} eye sees it"
            why = why or (
                f", so the zeros of the {EYE_NAMES[eye]} eye's joints are off by far, or "
                "something hides it"
            )
        cure = _POINT_CURE if isinstance(target, PointTarget) else _VIEW_CURE
        return [_finding(part, f"expected {target} in view {problem}{why}", cure)]

    def _cost(self, angles: FloatArray, pixels: FloatArray) -> tuple[float, bool]:
        """Sum of squared errors of the pixels' motion, and True if each is accepted."""
        head = self.config.head
        q = head.actuation.joints_of(angles)
        spare_px = _STEP_TOLERANCE_RAD * float(head.cameras.focal.mean())
        best: tuple[float, bool] = (np.inf, False)
        for distance_m in _DISTANCES_M:
            expected = _moved_pixels(head, q, pixels, distance_m)
            error = np.linalg.norm(pixels[1:] - expected, axis=-1)
            motion = np.linalg.norm(expected - pixels[:-1], axis=-1)
            seen = np.isfinite(pixels[1:] + pixels[:-1]).all(axis=-1)
            # an image that leaves the view is an error of a whole motion
            error = np.where(np.isfinite(error) | ~seen, error, 1e3)[seen]
            motion = np.nan_to_num(motion)[seen]
            kept = bool((error <= _STEP_TOLERANCE * motion + spare_px).all())
            best = min(best, (float(np.sum(error**2)), kept), key=lambda one: one[0])
        return best

    def _explained(self, angles: FloatArray, pixels: FloatArray) -> Finding:
        nominal, _ = self._cost(angles, pixels)
        costs = [
            (*self._cost(angles @ one.turns, one.pixels(pixels)), one.finding)
            for one in _explanations(self.config)
        ]
        able = sorted((one for one in costs if one[1] and one[0] < nominal), key=lambda one: one[0])
        if not able:
            return _finding(
                "view",
                "expected the target's image to move as the head file has it while each joint "
                f"turned, got {self._motions(angles, pixels)}; no single mistake explains it",
                "compare signs, ids, cameras and the head file, one joint at a time with "
                "`vergence jog`",
            )
        first, *others = [one[2] for one in able if one[0] <= _EQUAL_COST * able[0][0] + 20.0]
        also = "".join(f", or {one.part}: {one.problem}" for one in others[:2])
        return _finding(first.part, first.problem + also, first.cure)

    def _motions(self, angles: FloatArray, pixels: FloatArray) -> str:
        """Measured and expected motion of the target's image at each turn."""
        q = self.config.head.actuation.joints_of(angles)
        expected = _moved_pixels(self.config.head, q, pixels, 1.0) - pixels[:-1]
        texts = [
            f"{turn.servo.name} ({EYE_NAMES[eye]} eye) {_px(moved)} for {_px(wanted)}"
            for turn, both, model in zip(self.turns, np.diff(pixels, axis=0), expected, strict=True)
            for eye, (moved, wanted) in enumerate(zip(both, model, strict=True))
            if np.isfinite(moved).all() and max(np.abs(moved).max(), np.abs(wanted).max()) > 10.0
        ]
        return "; ".join(texts)

    def _zeros(self) -> list[Finding]:
        """Findings of lines of sight that miss each other, or of a size that contradicts them."""
        seen = [one for one in self.postures if np.isfinite(one.pixels).all()]
        head, eyes = self.config.head, [one for one in self.config.servos if one.slot >= NECK.stop]
        if not seen or _fit_zero(head, seen[0], None)[0] <= _MAX_CHI2:
            return []
        fits = [(*_fit_zero(head, seen[0], servo.slot), servo.name) for servo in eyes]
        able = sorted((one for one in fits if one[0] <= _MAX_CHI2), key=lambda one: abs(one[1]))
        expected = "expected lines of sight that meet at the target"
        if not able:
            problem = f"{expected}, got eyes that see it apart, which no single zero explains"
            cure = "set the zeros with `vergence jog`, and check the head file"
            return [_finding("view", problem, cure)]
        part = f"servos: {' or '.join(name for _, _, name in able[:2])}"
        off_rad = abs(able[0][1])
        problem = (
            f"{expected}, at the distance of its size, got a zero (zero_ticks) that is off by "
            f"about {off_rad:.2f} rad"
        )
        cure = "set it with `vergence jog`: zero, or calibrate the head"
        told = off_rad < _REFUSED_ZERO_RAD
        return [Finding(part=part, problem=problem, cure=cure, warning=told)]


def _px(moved: FloatArray) -> str:
    return f"({moved[0]:.0f}, {moved[1]:.0f}) px"


def _moved_pixels(
    head: HeadModel, q: FloatArray, pixels: FloatArray, distance_m: float
) -> FloatArray:
    """(n - 1, 2, 2) pixels in each next posture of the point that a pixel shows at a distance."""
    T_0_C = head.base_pose(q)[:, None] @ head.camera_poses(q)
    ideal = head.undistort(pixels)
    rays = (ideal - head.cameras.principal) / head.cameras.focal
    points = distance_m * np.concatenate([rays, np.ones((*rays.shape[:-1], 1))], axis=-1)
    world = np.einsum("neij,nej->nei", T_0_C[..., :3, :3], points) + T_0_C[..., :3, 3]
    T_N_0 = np.linalg.inv(head.base_pose(q[1:]))
    own = np.einsum("nij,nej->nei", T_N_0[:, :3, :3], world[:-1]) + T_N_0[:, None, :3, 3]
    shown = [head.project(q[1:], own[:, eye])[:, eye] for eye in range(2)]
    return np.stack(shown, axis=1)


def _fit_zero(head: HeadModel, posture: Posture, slot: int | None) -> tuple[float, float]:
    """Least sum of squares of a posture's images, and the error of a joint's zero, rad."""
    T_N_C = head.camera_poses(head.actuation.joints_of(posture.angles))
    middle = T_N_C[:, :3, 3].mean(axis=0)
    sigma_px = _ZERO_SIGMA_RAD * float(head.cameras.focal.mean())

    def residual(values: FloatArray) -> FloatArray:
        angles = posture.angles.copy()
        if slot is not None:
            angles[slot] += values[3]
        point = middle + np.array([values[0], values[1], 1.0]) / max(values[2], 1e-3)
        shown = head.project(head.actuation.joints_of(angles), point)
        pixels = np.nan_to_num((posture.pixels - shown) / sigma_px, nan=50.0)
        own_m = np.linalg.norm(point - T_N_C[:, :3, 3], axis=-1)
        sizes = np.nan_to_num(np.log(posture.ranges_m / own_m)) / _SIZE_SIGMA
        return np.concatenate([pixels.ravel(), sizes])

    best = (np.inf, 0.0)
    forward = T_N_C[:, :3, 2].mean(axis=0)
    count = 3 if slot is None else 4
    # slopes of the line of sight, inverse distance and zero: least, greatest
    bounds = np.array([[-5.0, -5.0, 0.05, -2.0], [5.0, 5.0, 20.0, 2.0]])[:, :count]
    for distance_m in (0.4, 1.5):
        start = np.append(forward[:2] / max(forward[2], 0.3), [1.0 / distance_m, 0.0])[:count]
        found = least_squares(residual, np.clip(start, *(0.99 * bounds)), bounds=tuple(bounds))
        off = 0.0 if slot is None else float(found.x[3])
        best = min(best, (2.0 * float(found.cost), off))
    return best


def _speeds(turn: Turn) -> Iterator[Finding]:
    """Findings of a joint that turns by another amount than it is told or tells."""
    least, most = _SPEED_RATIO
    if abs(turn.moved_rad) < _LEAST_TURN_RAD:
        return
    part = f"servos: {turn.servo.name}"
    goal = turn.moved_rad / turn.commanded_rad if turn.commanded_rad else 1.0
    if not least <= goal <= most:
        yield _finding(
            part,
            f"expected the joint to turn as far as it was told, got {goal:.2g} times that: the "
            "unit or scale in which the bus sends speeds",
            "compare it with the servo's manual (Dynamixel: GOAL_VELOCITY in 0.229 rev/min)",
        )
    told = turn.reported_rad / turn.moved_rad if turn.moved_rad else 1.0
    if not least <= told <= most:
        yield _finding(
            part,
            f"expected speeds that the change of its angle confirms, got {told:.2g} times that: "
            f"the {'sign' if told < 0.0 else 'unit or scale'} in which the bus reads speeds",
            "compare it with the servo's manual (Dynamixel: PRESENT_VELOCITY in 0.229 rev/min)",
        )


def _finding(part: str, problem: str, cure: str) -> Finding:
    return Finding(part=part, problem=problem, cure=cure)


def _explanations(config: HardwareConfig) -> Iterator[_Explanation]:
    """Mistakes of a configuration, the likelier ones first."""
    yield _Explanation(
        _finding(
            "cameras",
            "expected the left eye's images from cameras.left, got those of the right eye: the "
            "cameras are exchanged",
            "exchange source of [cameras.left] and [cameras.right]",
        ),
        pixels=lambda pixels: pixels[:, ::-1],
    )
    for servo in config.servos:
        problem = (
            "expected a joint that turns the eye as the head file has it, got one that turns it "
            "the other way: its sign is wrong"
        )
        cure = f"sign = {-servo.sign} (`vergence jog`: flip)"
        yield _Explanation(_finding(f"servos: {servo.name}", problem, cure), _scaled(servo, -1.0))
    for one, other in combinations(config.servos, 2):
        problem = (
            f"expected the id {one.id} to move {one.name} and {other.id} {other.name}, got the "
            "reverse: their ids are exchanged"
        )
        order = np.arange(7)
        order[[one.slot, other.slot]] = other.slot, one.slot
        cure = "exchange their ids in the configuration"
        part = f"servos: {one.name}, {other.name}"
        yield _Explanation(_finding(part, problem, cure), np.eye(7)[order])
    centres = 0.5 * (np.array(config.head.cameras.size, dtype=np.float64) - 1.0)
    ways = {"upside down": (-1.0, -1.0)}
    if not isinstance(config.target, AprilTag | TagFamily):  # unreadable if mirrored
        ways["mirrored"] = (-1.0, 1.0)
    for eyes, (what, scales) in product(([0, 1], [0], [1]), ways.items()):
        part = " and ".join(f"cameras.{EYE_NAMES[eye]}" for eye in eyes)
        problem = f"expected images as the eye sees them, got {what} ones"
        pixels = _about(centres, eyes, scales)
        yield _Explanation(_finding(part, problem, _FLIP_CURE), pixels=pixels)
    for servo, scale in product(config.servos, _SCALES):
        problem = (
            f"expected a joint that turns the eye by the angle of its encoder, got about "
            f"{scale:.2g} times that: its gear_ratio, or the encoder's scale"
        )
        ratio = f"{servo.gear_ratio / scale:.3g}"
        cure = f"gear_ratio = {ratio}, turns of the servo per turn of the joint"
        yield _Explanation(_finding(f"servos: {servo.name}", problem, cure), _scaled(servo, scale))
    for (eye, name), scale in product(enumerate(EYE_NAMES), _SCALES):
        problem = f"expected the head file's focal length, got about {scale:.2g} times that"
        finding = _finding(
            f"cameras.{name}", problem, "calibrate the camera, and check size and zoom"
        )
        pixels = _about(config.head.cameras.principal, [eye], 1.0 / scale)
        yield _Explanation(finding, pixels=pixels)


def _scaled(servo: ServoConfig, scale: float) -> FloatArray:
    return np.diag(np.where(np.arange(7) == servo.slot, scale, 1.0))


def _about(
    centres: FloatArray, eyes: list[int], scale: float | tuple[float, float]
) -> Callable[[FloatArray], FloatArray]:
    """Scaling of the pixels of some eyes about a point of each."""

    def scaled(pixels: FloatArray) -> FloatArray:
        found = pixels.copy()
        found[:, eyes] = centres[eyes] + (found[:, eyes] - centres[eyes]) * np.asarray(scale)
        return found

    return scaled
