"""A single gaze: turn both eyes to a target, and report its position with its uncertainty."""

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from math import inf
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vergence.controllers.controller import default_options, make_controller
from vergence.controllers.ibvs import gain_for_loop
from vergence.envs.plant import is_simulated
from vergence.envs.plants.cameras import RoomImageRenderer
from vergence.envs.reading import refuse_immobile_eyes
from vergence.envs.targets.prescribed import StaticTarget, UnseenTarget
from vergence.envs.task import EyeImages, GazeTask, Policy, given_or_drawn_eye_images, rollout
from vergence.errors import ConfigurationError
from vergence.eval.gaze_config import GazeConfig
from vergence.eval.gaze_trajectory import (
    MM,
    Trajectory,
    gaze_and_view_fixes,
    trajectory_of_first_head,
    truth_of_first_head,
)
from vergence.eval.head_summary import LEAST_RESIDUAL_PX
from vergence.eval.trials.goal import least_reachable_error
from vergence.eval.trials.metrics import settle_time
from vergence.hardware.config import load_hardware
from vergence.models.head import HeadModel, describe_beyond_limits
from vergence.models.head_file import load_head
from vergence.models.parts import EYE_NAMES, NECK, FloatArray
from vergence.models.posture import look_at
from vergence.operands import null_nonfinite_elements
from vergence.recording import Recorder
from vergence.recording.events import warn_of_gap
from vergence.triangulation import Fix
from vergence.vision.objects.scenes import parse_scene
from vergence.vision.objects.targets import GazeTarget, PlaceTarget, PointTarget, parse_gaze_target

_ROBOT_LAW: Final = "state-feedback"
"""The first law of `vergence.controllers.controller.WHICH_LAW`."""
_HARDWARE_PLANT: Final = "hardware"
"""The plant of robots."""


@dataclass(frozen=True, kw_only=True)
class GazeResult:
    """Result of one gaze."""

    config: GazeConfig
    head: HeadModel
    trajectory: Trajectory
    """Columns by name, one row per control period from time zero on; nan for unknown truth."""
    settle_1px_s: float
    """Time from which both eyes' true errors stay within 1 px of the residual, s; nan if they never
    do, or without ground truth."""
    settle_05px_s: float
    """Time from which they stay within 0.5 px, s; nan likewise."""
    residual: FloatArray
    """(2, 2) the least error that the head's actuators can reach at the target, by eye and image
    axis, px: zero if each eye joint has a motor of its own; nan without ground truth."""
    true_target_m: FloatArray
    """(3,) true position of the target in N, m; nan without ground truth, as on a real head."""
    gaze_fix: Fix
    """Fix by gaze from the last joint angles, one element."""
    view_fix: Fix
    """Fix from the last image, not older than 0.2 s, with the target visible in both eyes, and from
    the joint angles of its exposure; one element."""
    positions: FloatArray
    """(7,) the last joint angles, rad."""
    images: EyeImages | None
    """The eyes' last images; None for a robot that has none."""
    diagnostics: dict[str, int]
    """Counts of faults in a robot's loop, by name; empty for a simulation."""
    remark: str = ""
    """Why an eye has not seen the target, in words; empty if that is not known."""

    @property
    def has_truth(self) -> bool:
        """True if the plant provides the ground truth."""
        return bool(np.isfinite(self.true_target_m).all())

    @property
    def residual_px(self) -> float:
        """Residual of the worse eye, px; nan without ground truth."""
        return float(np.linalg.norm(self.residual, axis=-1).max())

    @property
    def has_residual(self) -> bool:
        """True if the actuators cannot bring both eyes onto the target together."""
        return self.residual_px > LEAST_RESIDUAL_PX

    @property
    def limitation(self) -> str:
        """Statement of the limitation that a residual implies."""
        exactly = "" if self.residual_px > 1.0 else "exactly "
        return f"the two eyes cannot both look {exactly}at the target"

    def summary(self) -> dict[str, Any]:
        """The result as plain values; None for missing ones."""
        return {
            "settle_1px_s": null_nonfinite_elements(self.settle_1px_s),
            "settle_05px_s": null_nonfinite_elements(self.settle_05px_s),
            "residual_px": null_nonfinite_elements(self.residual_px),
            "truth_mm": null_nonfinite_elements(MM * self.true_target_m),
            "gaze": self._method(self.gaze_fix),
            "itpc": self._method(self.view_fix),
            "gap_mm": null_nonfinite_elements(MM * self.gaze_fix.gap[0]),
            "controller": self.config.controller,
            "gain": self.config.gain,
            "plant": self.config.plant,
            "seed": self.config.seed,
            "head": self.head.name,
            "head_digest": self.head.digest,
            "diagnostics": self.diagnostics,
        }

    def _method(self, fix: Fix) -> dict[str, Any]:
        error = fix.point[0] - self.true_target_m
        return {
            "point_mm": null_nonfinite_elements(MM * fix.point[0]),
            "sigma_mm": null_nonfinite_elements(MM * fix.sigma[0]),
            "error_mm": null_nonfinite_elements(MM * error),
            "error_norm_mm": null_nonfinite_elements(MM * np.linalg.norm(error)),
            "gap_mm": null_nonfinite_elements(MM * fix.gap[0]),
            "covariance_mm2": null_nonfinite_elements(MM**2 * fix.covariance[0]),
        }


Watch = Callable[[GazeTask, int], None]
"""Observer of a gaze: called with the open task and the number of control periods done, from 0."""


def run_gaze(
    config: GazeConfig,
    progress: Callable[[float], None] | None = None,
    watch: Watch | None = None,
) -> GazeResult:
    """Bring the gaze to a target and triangulate it.

    Args:
        config: the gaze.
        progress: callback with the fraction done, after every control period.
        watch: observer of the gaze.

    Returns:
        The result.

    Raises:
        VergenceError: the head, plant or controller does not exist, or the eyes cannot see or
            fixate the target.
    """
    # what needs no head first: to load one compiles kernels
    default_options(config.controller or _ROBOT_LAW)  # raises for an unknown name
    simulated = is_simulated(config.plant)
    law = config.controller or ("ibvs" if simulated else _ROBOT_LAW)
    config, defaults = dataclasses.replace(config, controller=law), default_options(law)
    if not np.isfinite(config.target_mm).all():
        raise ConfigurationError(f"point: expected three finite numbers, got {config.target_mm}")
    if not 0.0 < config.duration_s < inf:
        raise ConfigurationError(
            f"duration: expected a number of seconds above 0, got {config.duration_s}"
        )
    config, head, plant_options = _hardware(config)
    config, look = _look(config, simulated)
    for name, value in (("scene", config.scene), ("wall", config.wall)):
        if value is not None and not simulated:
            raise ConfigurationError(f"{name}: expected none on a robot, got {value}")
        plant_options |= {} if value is None else {name: str(value)}
    refuse_immobile_eyes(head)
    rate = head.timing.control_rate_hz
    if not 1.0 <= config.duration_s * rate <= 1e6:
        raise ConfigurationError(
            f"duration: expected seconds, at least one control period of 1/{rate:g} s and at "
            f"most a million, got {config.duration_s}"
        )
    if config.gain is None:
        gain = gain_for_loop(head.timing) if config.controller == "ibvs" else defaults.get("gain")
        config = dataclasses.replace(config, gain=gain)
    options: dict[str, Any] = {} if config.gain is None else {"gain": config.gain}
    controller = make_controller(config.controller, head=head, **options)
    point = np.asarray(config.target_mm) / MM
    if simulated and look is not None:
        point = _on_surface(config, head, parse_gaze_target(look), point)
        config = dataclasses.replace(config, target_mm=tuple((MM * point).tolist()))
    refuses_unseen = look is None or not look.startswith("place:")
    if not refuses_unseen:
        look_at(head, point)  # raises if the eyes cannot
    refused = _why_unreachable(head, point, config.target_mm) if refuses_unseen else ""
    if refused and simulated:  # a robot looks at the target that it detects
        in_metres = not _why_unreachable(head, MM * point, config.target_mm)
        raise ConfigurationError(refused + (" (is it in metres?)" if in_metres else ""))
    x, y, z = point.tolist()
    target = (StaticTarget if refuses_unseen else UnseenTarget)(point=(x, y, z))
    plant_options |= {} if look is None else {"look": look}
    task = GazeTask(1, head=head, plant=config.plant, target=target, plant_options=plant_options)
    return record_gaze(task, controller, config, progress, watch)


def record_gaze(
    task: GazeTask,
    controller: Policy,
    config: GazeConfig,
    progress: Callable[[float], None] | None = None,
    watch: Watch | None = None,
) -> GazeResult:
    """Run the trial of a gaze, close its task, and evaluate the recording.

    Args:
        task: a task with one head.
        controller: the controller.
        config: the gaze, with the trial's duration and seed.
        progress: callback with the fraction done, after every control period.
        watch: observer of the gaze.

    Returns:
        The result.

    Raises:
        VergenceError: see `vergence.envs.task.rollout`.
    """
    steps = round(config.duration_s * task.head.timing.control_rate_hz)
    record = Recorder(task, steps)
    endings: list[FinalState] = []

    def keep(step: int) -> None:
        record(step)
        if watch is not None:
            watch(task, step)
        if step == steps:  # while the plant is open
            endings.append(FinalState.of(task))
        if step > 0 and progress is not None:
            progress(step / steps)

    rollout(task, controller, steps, keep, seed=config.seed)
    if config.hardware is not None:
        warn_of_gap(task.head, record.reading)
    return gaze_result(config, task, record, endings[-1])


class FinalState(NamedTuple):
    """Last images, counts and remark of a plant, taken before it closes; see `GazeResult`."""

    images: EyeImages | None
    diagnostics: dict[str, int]
    remark: str = ""

    @classmethod
    def of(cls, task: GazeTask) -> "FinalState":
        """Take the present images and counts of a task's first head."""
        images = given_or_drawn_eye_images(task, 0)
        return cls(images, task.plant.diagnostics(), task.plant.remark)


def gaze_result(
    config: GazeConfig, task: GazeTask, record: Recorder, final_state: FinalState | None = None
) -> GazeResult:
    """Evaluate a recorded gaze.

    Args:
        config: the gaze.
        task: a task with one head, open or closed.
        record: the recording, with all fields; it may have ended early.
        final_state: images and counts at the end; None if there are none, as after a replay.

    Returns:
        The result.
    """
    head, truth = task.head, truth_of_first_head(record)
    trajectory = trajectory_of_first_head(head, record)
    residual = np.full((2, 2), np.nan)
    if record.truth is not None:
        residual = least_reachable_error(task, truth.target[:1])[0]
    errors = truth.pixel_error - residual
    gaze, itpc = (Fix._make(part[-1:] for part in fix) for fix in gaze_and_view_fixes(head, record))
    images, diagnostics, remark = final_state or (None, {}, "")
    return GazeResult(
        config=config,
        head=head,
        trajectory=trajectory,
        settle_1px_s=float(settle_time(trajectory["time_s"], errors, 1.0)),
        settle_05px_s=float(settle_time(trajectory["time_s"], errors, 0.5)),
        residual=residual,
        true_target_m=truth.target[-1],
        gaze_fix=gaze,
        view_fix=itpc,
        positions=record.reading.positions[-1, 0],
        images=images,
        diagnostics=diagnostics,
        remark=remark,
    )


def _hardware(config: GazeConfig) -> tuple[GazeConfig, HeadModel, dict[str, Any]]:
    """Configuration with the head's name filled in, the head, and options of the plant."""
    if config.plant != _HARDWARE_PLANT:
        if config.hardware is not None:
            raise ConfigurationError(
                f"config: expected --plant {_HARDWARE_PLANT} beside a robot's configuration, got "
                f"--plant {config.plant}"
            )
        config = dataclasses.replace(config, head=config.head or "simulated")
        return config, load_head(config.head or ""), {}
    if config.hardware is None:
        raise ConfigurationError(
            f"config: expected the file that describes the robot of --plant {_HARDWARE_PLANT}, "
            "got none "
            "(vergence emulate --out FILE writes one for an emulated head)"
        )
    hardware = load_hardware(config.hardware)
    head = hardware.head if config.head is None else load_head(config.head)
    config = dataclasses.replace(config, head=config.head or hardware.head.name)
    return config, head, {"config": hardware, "view_check": config.view_check}


def _look(config: GazeConfig, simulated: bool) -> tuple[GazeConfig, str | None]:
    """Configuration with what the target implies, and its text; None for the plant's own."""
    text, scene = config.target, config.scene
    if text == "place":
        text = "place:" + ":".join(f"{value:g}" for value in config.target_mm)
    if text is None and config.pixel is not None:
        text = "point"
    if text is None and simulated and (scene is not None or config.wall is not None):
        text = parse_scene(scene or "ball", None).target
    if text is None:
        return config, None
    target = parse_gaze_target(text, config.pixel)
    if isinstance(target, PlaceTarget):
        config = dataclasses.replace(config, target="place", target_mm=target.point_mm)
    if simulated and isinstance(target, PointTarget) and target.pixel is not None:
        if scene not in (None, "room"):
            raise ConfigurationError(
                f"scene: expected room, or none, beside a pixel of the room, got {scene}"
            )
        config = dataclasses.replace(config, scene="room")
    return config, str(target)


def _on_surface(
    config: GazeConfig, head: HeadModel, target: GazeTarget, point: FloatArray
) -> FloatArray:
    """The point of a simulated room's wall at a pixel, or behind a point."""
    bare = config.scene is not None and config.scene.strip().lower() == "room"
    if not isinstance(target, PointTarget) or not (bare or target.pixel is not None):
        return point
    views = RoomImageRenderer(head, parse_scene("room"))
    pixel = head.project(head.rest(), point)[0] if target.pixel is None else target.pixel
    return views.surface(head.rest(), target.eye or 0, pixel)


def _why_unreachable(head: HeadModel, point: FloatArray, target_mm: object) -> str:
    """Reason why the eyes cannot see or fixate a target; empty if they can."""
    pixels = head.project(head.rest(), point)
    for eye, (name, size) in enumerate(zip(EYE_NAMES, head.cameras.size, strict=True)):
        if not ((pixels[eye] >= -0.5) & (pixels[eye] <= size - 0.5)).all():
            return (
                f"point: expected one in the {name} eye's view at rest, "
                f"got {target_mm} mm, which is {_outside(pixels[eye], size)}"
            )
    expected = f"point: expected one that both eyes can fixate, got {target_mm} mm, for which"
    q = head.fixate(point, head.rest()[NECK], warn=False)
    if not np.isfinite(q).all():
        return f"{expected} the eyes have no angles"
    beyond = describe_beyond_limits(head, q)
    return f"{expected} {beyond}" if beyond else ""


def _outside(pixel: FloatArray, size: NDArray[np.int64]) -> str:
    if not np.isfinite(pixel).all():
        return "behind it"
    return f"at pixel ({pixel[0]:.0f}, {pixel[1]:.0f}) of {size[0]} x {size[1]}"
