r"""The present error from an old image: a Smith predictor on the head's kinematics.

An image that was exposed d ago tells which joint angles fixate the target, `g = q(t - d) + a`: a is
what the eyes still had to turn at the exposure, from both pixels, their triangulated point and
the eyes' kinematics. The goal g belongs to the target, not to the eyes: while the target rests it
stays, and what is left to turn now is `g - q(t)`, whatever the eyes did since the exposure.

Each joint's goal is filtered by a scalar Kalman filter. A measurement's variance is that of the
pixels, of the encoders while the joint moves, of the head's model (a share of a), and the
square of what the plausible delays make of it; so a resting eye averages noise, and an image
that was exposed in motion counts for little until its delay is known. A goal far outside its
variance has jumped, or moves: the filter then begins anew from the measurement.
"""

from math import isfinite, nan
from typing import Any, Final, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vergence._jit import compiled, device
from vergence.controllers import delay as bank
from vergence.controllers.delay import (
    HYPOTHESES,
    IMAGE,
    LONGEST,
    RING,
    dating_error,
    least_misfit,
    likely_delay,
    remember_dates,
    remember_turn,
    weigh_delays,
)
from vergence.controllers.ibvs import DEFAULT_DEPTH_M, DEPTH_RANGE_M
from vergence.controllers.joint_rig import (
    ANGLE_STEP,
    LAG,
    LAG_INFORMATION,
    LATENCY,
    LOWER,
    NOMINAL_DELAY,
    PERIOD,
    PIXEL_SIGMA,
    UPPER,
    joint_rig,
    learn_lag,
    track_joint,
)
from vergence.envs.layout import Observation, ObservationLayout
from vergence.errors import ConfigurationError
from vergence.models.fixation import fixate_step
from vergence.models.head import HeadModel
from vergence.models.kinematics import (
    CAMERA_STRIDE,
    CAMERAS,
    eye_frames,
    into,
    out_of,
    point_in_eye,
)
from vergence.models.parts import FloatArray
from vergence.triangulation.rays import nearest

# a state's row of numbers
_COUNT: Final = 0
_DELAY: Final = 1
_LAG: Final = 2
_LAG_INFORMATION: Final = 3
_NOISE: Final = 4
_UNSEEN: Final = 5
_DEPTH: Final = 7
_RANGE: Final = 9
_STILL: Final = 11
_VELOCITY: Final = 12
_GOAL: Final = 16
_VARIANCE: Final = 20
_RING: Final = 24
_IMAGES: Final = _RING + 4 * RING
_MISFIT: Final = _IMAGES + 3 * IMAGE
_SIZE: Final = _MISFIT + 2 * HYPOTHESES

HOLD_S: Final = 0.5
"""How long the goal of an eye that does not see is held."""
_STILL_RAD_S: Final = 0.005
"""Slower, no delay in question moves the eye by a pixel."""
_MODEL: Final = 0.005
"""Share of the angle to turn that the head's model leaves uncertain."""
_ENCODER: Final = 0.3
"""What tracking leaves of an encoder's step while the joint moves."""
_PROCESS: Final = 0.05
"""How much a goal may wander from image to image, as a share of the pixels' variance."""
_GATE: Final = 9.0
"""Square of the innovation, by its variance, beyond which a goal has jumped."""
_NOISE_SHARE: Final = 0.1
_NEWTON: Final = 10


class Prediction(NamedTuple):
    """Where the eyes are to turn, now."""

    to_go: FloatArray
    """(..., 4) angles that each eye joint still has to turn from its present one, rad; 0 for an
    eye whose target is not known."""
    pixel_error: FloatArray
    """(..., 2, 2) what the pixel errors are now, undistorted, px; nan where not known."""
    delay_s: FloatArray
    """(...) the delay from exposure to reading, s."""
    known: NDArray[np.bool_]
    """(..., 2) whether each eye's target is known: seen now or a short while ago."""
    positions: FloatArray
    """(..., 4) present angles, finer than the encoders, rad."""
    velocities: FloatArray
    """(..., 4) present velocities, rad/s."""
    lag_s: FloatArray
    """(...) the lag with which velocities follow their commands, s."""


class Predictor:
    """Turns old images into present errors, for any number of heads.

    Args:
        head: the model of the head.
        layout: the layout of observations.
        delay: `nominal` dates images by the head's own latency, `estimated` begins there and
            finds the delay on line, see `vergence.controllers.delay`.
        lag: the same of the joints' lag, see `vergence.controllers.joint_rig`.

    Raises:
        ConfigurationError: an option has a value that cannot be, or the head's latency is
            longer than any hypothesis.
    """

    def __init__(
        self,
        *,
        head: HeadModel,
        layout: ObservationLayout,
        delay: Literal["estimated", "nominal"] = "estimated",
        lag: Literal["estimated", "nominal"] = "estimated",
    ) -> None:
        for name, value in (("delay", delay), ("lag", lag)):
            if value not in ("estimated", "nominal"):
                raise ConfigurationError(
                    f"{name}: expected 'estimated' or 'nominal', got {value!r}"
                )
        if head.timing.latency_frames > LONGEST:
            raise ConfigurationError(
                f"head: expected a latency of at most {LONGEST} control periods, "
                f"got {head.timing.latency_frames}"
            )
        self.head = head
        self.layout = layout
        self.rig = joint_rig(head)
        self._estimates = (delay == "estimated", lag == "estimated" and head.timing.lag_s > 0.0)

    @property
    def size(self) -> int:
        """Length of a head's state."""
        return _SIZE

    def initial(self) -> FloatArray:
        """(size,) the state before the first observation."""
        row = np.zeros(_SIZE)
        row[_DELAY] = self.rig[NOMINAL_DELAY]
        row[_LAG], row[_LAG_INFORMATION] = self.rig[LAG], LAG_INFORMATION
        row[_NOISE] = self.rig[PIXEL_SIGMA] ** 2
        row[_DEPTH : _DEPTH + 2] = DEFAULT_DEPTH_M
        row[_GOAL : _GOAL + 4] = nan
        row[_IMAGES:_MISFIT:IMAGE] = -1.0
        return row

    def update(self, seen: Observation, state: FloatArray) -> Prediction:
        """Take one control period's observation.

        Args:
            seen: the observation of some heads.
            state: (..., size) their states, changed in place; C-contiguous float64.

        Returns:
            What is left to turn at present.
        """
        leading = state.shape[:-1]
        rows = state.reshape(-1, _SIZE)
        num = len(rows)
        to_go, error = np.empty((num, 4)), np.empty((num, 2, 2))
        known = np.empty((num, 2), dtype=np.bool_)
        now, speed = np.empty((num, 4)), np.empty((num, 4))
        _update(
            rows,
            np.ascontiguousarray(seen.positions).reshape(-1, 7),
            np.ascontiguousarray(seen.velocities).reshape(-1, 7),
            np.ascontiguousarray(seen.last_command).reshape(-1, 4),
            np.ascontiguousarray(seen.image_age_s).reshape(-1),
            np.ascontiguousarray(seen.pixel_error).reshape(-1, 2, 2),
            self.rig,
            self.head.packed,
            *self._estimates,
            to_go,
            error,
            known,
            now,
            speed,
        )
        return Prediction(
            to_go.reshape(*leading, 4),
            error.reshape(*leading, 2, 2),
            (rows[:, _DELAY] * self.rig[PERIOD]).reshape(leading),
            known.reshape(*leading, 2),
            now.reshape(*leading, 4),
            speed.reshape(*leading, 4),
            rows[:, _LAG].reshape(leading).copy(),
        )

    def angles_at_exposure(self, state: FloatArray) -> FloatArray:
        """The eyes' angles at the exposure of an image that has just come, by the present delay.

        Args:
            state: (..., size) after `update`.

        Returns:
            (..., 4) rad.
        """
        rows = state.reshape(-1, _SIZE)
        slots = (rows[:, _COUNT].astype(np.int64) - 1 - rows[:, _DELAY].astype(np.int64)) % RING
        rings = rows[:, _RING:_IMAGES].reshape(-1, RING, 4)
        return rings[np.arange(len(rows)), slots].reshape(*state.shape[:-1], 4)


@device
def _track(row: Any, positions: Any, velocities: Any, command: Any, rig: Any, learn: bool) -> None:
    """Bring the ring of angles, the velocities and the lag up to date."""
    count = int(row[_COUNT])
    row[_COUNT] = count + 1
    if count == 0:
        # a trial begins at rest
        for slot in range(RING):
            for j in range(4):
                row[_RING + 4 * slot + j] = positions[3 + j]
        for j in range(4):
            row[_VELOCITY + j] = velocities[3 + j]
        return
    before, now = (count - 1) % RING, count % RING
    lag, information = row[_LAG], row[_LAG_INFORMATION]
    for j in range(4):
        q, v, u = row[_RING + 4 * before + j], row[_VELOCITY + j], command[j]
        q_read, v_read = positions[3 + j], velocities[3 + j]
        if learn:
            lag, information = learn_lag(rig, j, v, u, v_read, lag, information)
        q, v = track_joint(rig, j, q, v, u, row[_LAG], q_read, v_read)
        row[_RING + 4 * now + j] = q
        row[_VELOCITY + j] = v
        if abs(v) > _STILL_RAD_S:
            row[_STILL] = -1.0
    row[_STILL] += 1.0
    row[_LAG], row[_LAG_INFORMATION] = lag, information


@device
def _measure(row: Any, error: Any, rig: Any, p: Any, image: Any) -> None:
    """The goals of a fresh image, from the angles at its exposure."""
    count, delay = int(row[_COUNT]) - 1, int(row[_DELAY])
    ring = row[_RING:_IMAGES]
    then = 4 * ((count - delay) % RING)
    i, k = CAMERAS, CAMERAS + CAMERA_STRIDE
    cl = eye_frames(p, 0, ring[then], ring[then + 1])[2]
    cr = eye_frames(p, 1, ring[then + 2], ring[then + 3])[2]
    ol, orr = (cl[3], cl[7], cl[11]), (cr[3], cr[7], cr[11])
    tip_l = out_of(cl, error[0, 0] / p[i], error[0, 1] / p[i + 1], 1.0)
    tip_r = out_of(cr, error[1, 0] / p[k], error[1, 1] / p[k + 1], 1.0)
    dl = (tip_l[0] - ol[0], tip_l[1] - ol[1], tip_l[2] - ol[2])
    dr = (tip_r[0] - orr[0], tip_r[1] - orr[1], tip_r[2] - orr[2])
    # one eye alone keeps the depth that both saw last
    s, t, found = nearest(ol, dl, orr, dr)
    if found:
        row[_DEPTH] = min(max(s, DEPTH_RANGE_M[0]), DEPTH_RANGE_M[1])
        row[_DEPTH + 1] = min(max(t, DEPTH_RANGE_M[0]), DEPTH_RANGE_M[1])
    for eye in range(2):
        if not (isfinite(error[eye, 0]) and isfinite(error[eye, 1])):
            image[bank.GOAL + 2 * eye] = image[bank.GOAL + 2 * eye + 1] = nan
            continue
        z = row[_DEPTH + eye]
        o, d = (ol, dl) if eye == 0 else (orr, dr)
        x, y, z = o[0] + z * d[0], o[1] + z * d[1], o[2] + z * d[2]
        tilt, pan = ring[then + 2 * eye], ring[then + 2 * eye + 1]
        if isfinite(row[_GOAL + 2 * eye]):  # Newton's method from the last goal needs one step
            tilt, pan = row[_GOAL + 2 * eye], row[_GOAL + 2 * eye + 1]
        for _ in range(_NEWTON):
            dt, dp = fixate_step(p, eye, tilt, pan, x, y, z)
            tilt += min(max(dt, -0.5), 0.5)
            pan += min(max(dp, -0.5), 0.5)
            if abs(dt) + abs(dp) < 1e-4:  # what is left is its square
                break
        image[bank.GOAL + 2 * eye], image[bank.GOAL + 2 * eye + 1] = tilt, pan
        row[_RANGE + eye] = into(eye_frames(p, eye, tilt, pan)[2], x, y, z)[2]
        remember_turn(image, tilt - ring[then + 2 * eye], pan, eye)
    remember_dates(image, ring, count, delay)


@device
def _learn_delay(row: Any, new: Any, rig: Any) -> None:
    """Weigh the delays by a new image, and date it by the best."""
    ring, misfit = row[_RING:_IMAGES], row[_MISFIT:_SIZE]
    old = row[_IMAGES + IMAGE : _IMAGES + 2 * IMAGE]
    older = row[_IMAGES + 2 * IMAGE : _MISFIT]
    noise = weigh_delays(misfit, ring, new, old, older, rig, row[_NOISE], row[_STILL] >= RING)
    if noise >= 0.0:
        # a jump is no noise
        noise = min(noise, 16.0 * row[_NOISE])
        row[_NOISE] += _NOISE_SHARE * (noise - row[_NOISE])
        row[_NOISE] = max(row[_NOISE], rig[PIXEL_SIGMA] ** 2)
    row[_DELAY] = new[bank.DATED] = likely_delay(misfit, rig)


@device
def _filter(row: Any, image: Any, rig: Any, uncertain: bool) -> None:
    """Take a new image's goals into the filtered ones."""
    count, delay = int(row[_COUNT]) - 1, int(row[_DELAY])
    ring, misfit = row[_RING:_IMAGES], row[_MISFIT:_SIZE]
    then, now = 4 * ((count - delay) % RING), 4 * (count % RING)
    least = least_misfit(misfit) if uncertain else 0.0
    pixel = row[_NOISE]
    for eye in range(2):
        a = 2 * eye
        if not isfinite(image[bank.GOAL + a]):
            continue
        begins = not isfinite(row[_GOAL + a])
        goals = bank.dated(image, ring, delay, eye)
        datings = (0.0, 0.0)
        if uncertain:
            datings = dating_error(misfit, least, ring, image, eye)
        for j in range(a, a + 2):
            goal, dating = goals[j - a], datings[j - a]
            encoder = 0.0
            if abs(ring[now + j] - ring[then + j]) > 0.25 * rig[ANGLE_STEP]:
                encoder = _ENCODER * rig[ANGLE_STEP]
            model = _MODEL * (goal - ring[then + j])
            variance = pixel + encoder * encoder + model * model + dating * dating
            before = row[_VARIANCE + j] + _PROCESS * pixel
            innovation = goal - row[_GOAL + j]
            if begins:
                row[_GOAL + j], row[_VARIANCE + j] = goal, variance
                continue
            if innovation * innovation > _GATE * (before + variance):
                before += innovation * innovation
            gain = before / (before + variance)
            row[_GOAL + j] += gain * innovation
            row[_VARIANCE + j] = (1.0 - gain) * before


@compiled
def _update(
    rows: Any, positions: Any, velocities: Any, command: Any, age: Any, error: Any, rig: Any,
    p: Any, learn_delay: bool, learn_lags: bool, to_go: Any, present_error: Any, known: Any,
    now: Any, speed: Any,
) -> None:  # fmt: skip
    hold = round(HOLD_S / rig[PERIOD])
    for n in range(rows.shape[0]):
        row = rows[n]
        _track(row, positions[n], velocities[n], command[n], rig, learn_lags)
        fresh = abs(age[n] - rig[LATENCY]) < 0.5 * rig[PERIOD]
        for eye in range(2):
            row[_UNSEEN + eye] += 1.0
            if fresh and isfinite(error[n, eye, 0]) and isfinite(error[n, eye, 1]):
                row[_UNSEEN + eye] = 0.0
        if fresh and (row[_UNSEEN] == 0.0 or row[_UNSEEN + 1] == 0.0):
            new = row[_IMAGES : _IMAGES + IMAGE]
            _measure(row, error[n], rig, p, new)
            if learn_delay:
                _learn_delay(row, new, rig)
            _filter(row, new, rig, learn_delay)
            for i in range(IMAGE):
                row[_IMAGES + 2 * IMAGE + i] = row[_IMAGES + IMAGE + i]
                row[_IMAGES + IMAGE + i] = new[i]
        slot = _RING + 4 * ((int(row[_COUNT]) - 1) % RING)
        for j in range(4):
            now[n, j], speed[n, j] = row[slot + j], row[_VELOCITY + j]
        for eye in range(2):
            a = 2 * eye
            if row[_UNSEEN + eye] > hold:
                row[_GOAL + a] = row[_GOAL + a + 1] = nan
            known[n, eye] = isfinite(row[_GOAL + a])
            for j in range(a, a + 2):
                goal = min(max(row[_GOAL + j], rig[LOWER + j]), rig[UPPER + j])
                to_go[n, j] = goal - now[n, j] if known[n, eye] else 0.0
            if not known[n, eye]:
                present_error[n, eye, 0] = present_error[n, eye, 1] = nan
                continue
            # the point that is on the axis when the eye has turned there
            camera = eye_frames(p, eye, row[_GOAL + a], row[_GOAL + a + 1])[2]
            px, py, pz = out_of(camera, 0.0, 0.0, row[_RANGE + eye])
            x, y, z = point_in_eye(p, eye, now[n, a], now[n, a + 1], px, py, pz)
            c = CAMERAS + eye * CAMERA_STRIDE
            if z > 0.0:
                present_error[n, eye, 0] = p[c] * x / z
                present_error[n, eye, 1] = p[c + 1] * y / z
            else:
                present_error[n, eye, 0] = present_error[n, eye, 1] = nan
