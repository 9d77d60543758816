r"""Closed-loop gaze: hold a target, and record the sensors and the fixes of both methods.

```python
record = hold_gaze(ClosedLoop(head=head, target={"kind": "static", "point": (0, -0.1, 1)},
                              samples=1150, plant_options={"board": "checkerboard"}))
record.itpc.point - record.target_at_exposure       # (1150, 3) m
```

The loop's noise bandwidth says how much of the detector's noise reaches the eyes. The model holds
per eye and image axis, in pixels, if the law's Jacobian is exact. The image exposed `d` periods ago
showed the target at `x(k - d) + n(k - d)` from the principal point, with detection noise n. The
command is `u(k) = -g (x(k - d) + n(k - d))`. Over the period T the joint's velocity v follows its
command with the time constant tau,

    v(k+1) = a v(k) + (1 - a) u(k),                              a = exp(-T / tau)
    x(k+1) = x(k) + tau (1 - a) v(k) + (T - tau (1 - a)) u(k).

White noise n of unit variance drives this linear system to a stationary variance of x, the sum
of the squares of its impulse response, which solves a discrete Lyapunov equation.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from math import exp
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import solve_discrete_lyapunov

from vergence.controllers.ibvs import as_gains, ibvs_command
from vergence.envs.observation import ObservationLayout
from vergence.envs.plant import simulation_of
from vergence.envs.streams import IntArray
from vergence.envs.targets.motion import Target
from vergence.envs.task import GazeTask, rollout
from vergence.errors import ConfigurationError
from vergence.models.geometry import DenavitHartenberg
from vergence.models.head import HeadModel
from vergence.models.parts import FloatArray
from vergence.recording import Recorder
from vergence.triangulation import Fix, Noise, triangulate_gaze, triangulate_views


class PerTrialGainLaw:
    """The article's control law with gains per trial and a reference per control period.

    Gains have shape (..., 2, 2) by trial, eye and image axis, 1/s. The reference gives for a
    control period, counted from 0, the image position (..., 2, 2) at which to hold the target, px
    from the principal points.
    """

    def __init__(
        self, head: HeadModel, gain: FloatArray, reference: Callable[[int], FloatArray]
    ) -> None:
        self._head, self._gain, self._reference = head, gain, reference
        self._layout = ObservationLayout.of(head)

    def predict(
        self, observation: NDArray[np.float32], state: Any = None,
        episode_start: NDArray[np.bool_] | None = None, deterministic: bool = True,
    ) -> tuple[NDArray[np.float32], int]:  # fmt: skip
        """See `vergence.envs.task.Policy`; the state is the number of the control period."""
        step = 0 if state is None else int(state)
        seen, limits = self._layout.decode(observation), np.array(self._layout.action_limits)
        error = seen.pixel_error - self._reference(step)
        command = ibvs_command(
            seen.positions_at_exposure, error, self._gain, np.nan, limits, self._head.packed
        )
        return self._layout.action(command), step + 1


def servo_pixel_errors(
    head: HeadModel, target: Target, gains: ArrayLike, *, duration_s: float, seed: int,
    first_trial: int = 0, plant: str = "kinematic",
    plant_options: Mapping[str, Any] | None = None,
) -> tuple[FloatArray, FloatArray]:  # fmt: skip
    """Turn heads to a target under the article's law; gains k1 and k2 per trial, (n, 2), 1/s.

    Returns (steps,) seconds since time zero, and (steps, n, 2, 2) true pixel errors, px.
    """
    gain = np.asarray(gains, dtype=np.float64)
    # both eyes have the same gains
    law = PerTrialGainLaw(head, np.repeat(gain[:, None, :], 2, axis=1), lambda _step: np.zeros(2))
    task = GazeTask(len(gain), head=head, plant=plant, target=target, plant_options=plant_options)
    steps = round(duration_s * head.timing.control_rate_hz)
    simulation_of(task.plant)  # refuses a plant without ground truth
    record = Recorder(task, steps, reading=(), truth=("pixel_error",))
    rollout(task, law, steps, record, seed=seed, first_trial=first_trial)
    assert record.truth is not None
    time_s = np.arange(steps + 1) * head.timing.period_s
    return np.asarray(time_s), record.truth.pixel_error


MM: Final = 1000.0
"""Millimetres per metre (physical)."""
_READING: Final = ("time_s", "exposure_s", "pixels", "positions", "positions_at_exposure")


@dataclass(frozen=True, kw_only=True)
class ClosedLoop:
    """A head, or several side by side, under the article's control law; picklable."""

    head: HeadModel
    """The model that the controller and the triangulation use."""
    target: Mapping[str, Any] | Target
    """The target, see `vergence.envs.targets.make_target`."""
    samples: int
    """Number of samples to record after settling."""
    true_head: HeadModel | None = None
    """The head that moves: one, or a population of shape (num,); None for the model itself."""
    num: int | None = None
    """Number of heads side by side, each with its own noise; None for one, without that axis."""
    every: int = 1
    """Control periods from sample to sample."""
    settle_s: float = 1.5
    """Settling time before the first sample, s; the image of that sample is one latency older."""
    references_px: tuple[tuple[float, float], ...] = ((0.0, 0.0),)
    """Image positions at which to hold the target, (u, v) from the principal point of both eyes,
    px: each in turn for an equal fraction of the samples, the first also while settling. Several
    references make a dithered fixation."""
    plant: str = "rendered"
    """The simulated plant, see `vergence.envs.plant.PLANTS`."""
    plant_options: Mapping[str, Any] = field(default_factory=dict)
    """The plant's own options, except `true_head`."""
    gain: float = 4.0
    """The law's gain, 1/s."""
    seed: int = 0
    """Seed of all noise."""
    trial: int = 0
    """Trial number of the first head under that seed; the other heads take the next numbers."""

    def of_heads(self, heads: HeadModel, trial: int, images: bool = False) -> "ClosedLoop":
        """This loop with true heads of batch shape (n,), on rendered images if asked for."""
        loop = replace(self, true_head=heads, num=heads.batch_shape[0], trial=trial)
        return replace(loop, plant="rendered", plant_options={}) if images else loop


class GazeRecord(NamedTuple):
    """Record of a closed loop, one row per sample, of one head or of several.

    Shapes below are for one head, (samples, ...); several heads have (samples, num, ...). Fields
    named `..._at_exposure` belong to the exposure of the newest image, one latency before the
    present.
    """

    time_s: FloatArray
    """(samples,) the present, s."""
    exposure_s: FloatArray
    """(samples,) exposure time of the newest image by the nominal latency, s."""
    pixels: FloatArray
    """(samples, 2, 2) raw detections in the newest image, px; nan if not visible."""
    pixel_error: FloatArray
    """(samples, 2, 2) undistorted detections minus the model's principal points, px."""
    true_pixels_at_exposure: FloatArray
    """(samples, 2, 2) true position of the target in that image, raw px."""
    positions: FloatArray
    """(samples, 7) joint feedback at present, rad."""
    positions_at_exposure: FloatArray
    """(samples, 7) joint feedback at exposure, rad."""
    target: FloatArray
    """(samples, 3) target position at present, in N, m."""
    target_at_exposure: FloatArray
    """(samples, 3) target position at the exposure of the newest image, in N, m."""
    gaze: Fix
    """Fixes by gaze, from the present joint angles."""
    itpc: Fix
    """Fixes by ITPC, from pixels and joint angles at the exposure of the newest image."""

    @property
    def gaze_error_mm(self) -> FloatArray:
        """(samples, 3) gaze fix minus the target position at present, mm."""
        return MM * (self.gaze.point - self.target)

    @property
    def itpc_error_mm(self) -> FloatArray:
        """(samples, 3) ITPC fix minus the target position at exposure, mm."""
        return MM * (self.itpc.point - self.target_at_exposure)


def hold_gaze(loop: ClosedLoop) -> GazeRecord:
    """Bring the gaze to a target, let it settle, and record."""
    _check(loop)
    head, num = loop.head, 1 if loop.num is None else loop.num
    options = dict(loop.plant_options)
    if loop.true_head is not None:
        options["true_head"] = loop.true_head
    settling = round(loop.settle_s * head.timing.control_rate_hz)
    steps = settling + (loop.samples - 1) * loop.every
    references = np.asarray(loop.references_px, dtype=np.float64)

    def reference(step: int) -> FloatArray:
        sample = max((step - settling) // loop.every, 0)
        share = min(sample * len(references) // loop.samples, len(references) - 1)
        return np.asarray(references[share])

    law = PerTrialGainLaw(head, as_gains("gain", loop.gain), reference)
    task = GazeTask(num, head=head, plant=loop.plant, target=loop.target, plant_options=options)
    simulation_of(task.plant)  # refuses a plant without ground truth
    record = Recorder(task, steps, reading=_READING, truth=("positions", "target"))
    rollout(task, law, steps, record, seed=loop.seed, first_trial=loop.trial)
    return _samples(loop, record, settling + loop.every * np.arange(loop.samples))


def _samples(loop: ClosedLoop, record: Recorder, present: IntArray) -> GazeRecord:
    """The rows of a record at which samples are taken."""
    reading, truth, head = record.reading, record.truth, loop.head
    assert truth is not None
    exposure_s, positions = reading.exposure_s[present], reading.positions[present]
    pixels, at_exposure = reading.pixels[present], reading.positions_at_exposure[present]
    true_head = head if loop.true_head is None else loop.true_head
    # a missing image, or one from before time zero, counts as exposed at time zero
    exposed = np.nan_to_num(exposure_s * head.timing.control_rate_hz)
    steps = np.maximum(np.rint(exposed), 0).astype(np.int64)
    places = np.arange(steps.shape[1])
    then = truth.target[steps, places]
    samples = GazeRecord(
        time_s=reading.time_s[present], exposure_s=exposure_s, pixels=pixels,
        pixel_error=record.pixel_error[present],
        true_pixels_at_exposure=true_head.project(truth.positions[steps, places], then),
        positions=positions, positions_at_exposure=at_exposure, target=truth.target[present],
        target_at_exposure=then, gaze=triangulate_gaze(head, positions),
        itpc=triangulate_views(head, at_exposure, pixels),
    )  # fmt: skip
    # one head alone has no axis over heads
    return samples if loop.num is not None else GazeRecord._make(map(_first, samples))


def _first(value: Any) -> Any:
    """The first head's part of an array, or of each array of a fix."""
    return Fix._make(part[:, 0] for part in value) if isinstance(value, Fix) else value[:, 0]


def _check(loop: ClosedLoop) -> None:
    for name in ("samples", "every", "num"):
        value = getattr(loop, name)
        if value is not None and value < 1:
            raise ConfigurationError(f"{name}: expected at least 1, got {value}")
    if not (np.isfinite(loop.settle_s) and loop.settle_s >= 0.0):
        raise ConfigurationError(f"settle_s: expected seconds >= 0, got {loop.settle_s}")
    if np.shape(loop.references_px) != (len(loop.references_px), 2) or not loop.references_px:
        raise ConfigurationError(
            f"references_px: expected pairs of pixels, got {loop.references_px}"
        )


def dither_references_px(points_per_side: int) -> tuple[tuple[float, float], ...]:
    """Square grid of references that covers one pixel evenly around the principal point.

    The detector's bias depends on the sub-pixel position of the target. Over the grid it averages
    out, except for its harmonics with a multiple of `points_per_side` periods per pixel.
    """
    offsets = (np.arange(points_per_side) - 0.5 * (points_per_side - 1)) / points_per_side
    return tuple((float(u), float(v)) for v in offsets for u in offsets)


def detection_sigma(pixels: FloatArray) -> FloatArray:
    """(..., 2, 2) standard deviation of n detections (n, ..., 2, 2), px (Eqs. 25 and 26)."""
    return np.asarray(np.nanstd(pixels, axis=0, ddof=1))


def gaze_uncertainty_mm(head: HeadModel, q: FloatArray, sigma_px: FloatArray) -> FloatArray:
    """(..., 3) standard deviation of a gaze fix as in the article (Eqs. 27 to 33), mm.

    Tilt and pan are taken as the arctangent of pixel over focal length f in px, so at the principal
    point one pixel of noise is 1/f radians of either. The noise has shape (..., 2, 2), by eye and
    coordinate.
    """
    angle = sigma_px / head.cameras.focal
    joints = np.zeros((*angle.shape[:-2], 7))
    joints[..., 3:] = angle[..., ::-1].reshape(*angle.shape[:-2], 4)
    return MM * triangulate_gaze(head, q, Noise(joint_rad=joints)).sigma


def itpc_uncertainty_mm(
    head: HeadModel, q: FloatArray, pixels: FloatArray, sigma_px: FloatArray
) -> FloatArray:
    """(..., 3) standard deviation of a fix from two pixels (Eqs. 34 to 36), mm."""
    return MM * triangulate_views(head, q, pixels, Noise(pixel_px=sigma_px)).sigma


def corrected_gaze_fix(
    head: HeadModel, q: FloatArray, pixel_error: FloatArray, depth_m: FloatArray
) -> Fix:
    """Triangulate by gaze from angles corrected to first order for the remaining pixel error.

    The pixel error is (..., 2, 2), undistorted pixel minus principal point, px; the depth is (...,
    2), that of the target in each eye, m.
    """
    principal = np.broadcast_to(head.cameras.principal, pixel_error.shape)
    jacobian = head.image_jacobian(q, principal, depth_m)
    corrected = np.array(q)
    for eye in range(2):
        own = slice(3 + 2 * eye, 5 + 2 * eye)
        # turning by J^-1 (p* - p) brings the target to the principal point
        error = pixel_error[..., eye, :, None]
        turn = np.linalg.solve(jacobian[..., eye, :, own], -error)
        corrected[..., own] += turn[..., 0]
    return triangulate_gaze(head, corrected)


@dataclass(frozen=True, kw_only=True)
class LinearLoop:
    """A sampled gaze loop, linearised for small signals."""

    gain: float
    """The law's gain, 1/s."""
    period_s: float
    """The control period, s; one frame is taken in each."""
    delay_periods: int
    """Control periods from exposure to reading."""
    lag_s: float
    """Time constant of the joints' velocity, s; 0 for none."""

    @staticmethod
    def of(head: HeadModel, gain: float) -> "LinearLoop":
        """The loop of a head; its frames come at the control rate."""
        timing = head.timing
        delay, lag_s = timing.latency_frames, timing.lag_s
        return LinearLoop(gain=gain, period_s=timing.period_s, delay_periods=delay, lag_s=lag_s)

    def at_rate(self, rate_hz: float) -> "LinearLoop":
        """This loop at another rate, its delay in seconds rounded to whole periods."""
        delay = round(self.delay_periods * self.period_s * rate_hz)
        return replace(self, period_s=1.0 / rate_hz, delay_periods=delay)


def _matrices(loop: LinearLoop) -> tuple[FloatArray, FloatArray]:
    """Transition matrix of the state (x(k), v(k), x(k-1), ..., x(k-d)), and noise input vector."""
    size = 2 + loop.delay_periods
    left = exp(-loop.period_s / loop.lag_s) if loop.lag_s > 0.0 else 0.0
    glide = loop.lag_s * (1.0 - left)
    drive = np.zeros(size)
    drive[0], drive[1] = loop.period_s - glide, 1.0 - left
    step = np.zeros((size, size))
    step[0, 0], step[0, 1], step[1, 1] = 1.0, glide, left
    for past in range(loop.delay_periods):
        step[2 + past, 0 if past == 0 else 1 + past] = 1.0
    seen = 0 if loop.delay_periods == 0 else size - 1
    step[:, seen] -= loop.gain * drive
    return step, -loop.gain * drive


def noise_gain(loop: LinearLoop) -> float:
    """Ratio of the optical axis' scatter to that of white detections; inf if unstable."""
    step, noise = _matrices(loop)
    if np.abs(np.linalg.eigvals(step)).max() >= 1.0:
        return float("inf")
    return float(np.sqrt(solve_discrete_lyapunov(step, np.outer(noise, noise))[0, 0]))


def noise_bandwidth_hz(loop: LinearLoop) -> float:
    """Equivalent noise bandwidth: bandwidth of an ideal low-pass with equal output variance, Hz."""
    return 0.5 * noise_gain(loop) ** 2 / loop.period_s


def with_joint_offsets(head: HeadModel, added_rad: FloatArray) -> HeadModel:
    """Add (..., 9) joint offsets, rad: a head's joints then differ from their encoders."""
    if not isinstance(head.links, DenavitHartenberg):
        raise ConfigurationError(
            f"head: expected one of the article's form, nine Denavit-Hartenberg rows, got "
            f"{head.name!r}, whose joints are given by axes"
        )
    return head.replace(links={"offset": head.links.offset + added_rad})
