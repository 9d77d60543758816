r"""The present error from an old image: a Smith predictor on the head's kinematics.

An image that was exposed d ago tells which joint angles fixate the target, `g = q(t - d) + a`: a is
what the eyes still had to turn at the exposure, from both pixels, their triangulated point and
the eyes' kinematics. The goal g belongs to the target, not to the eyes: while the target rests it
stays, and what is left to turn now is `g - q(t)`, whatever the eyes did since the exposure.

Goals are filtered from image to image, see `vergence.controllers.prediction.fixation_angles`;
delay and lag are found on line, see `vergence.controllers.prediction.delay` and
`vergence.controllers.prediction.joints`.
"""

from math import isfinite, nan
from typing import Any, Final, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vergence._jit import compiled
from vergence.controllers.prediction.delay import LONGEST, RING
from vergence.controllers.prediction.fixation_angles import present_of, take_image
from vergence.controllers.prediction.joints import LATENCY, PERIOD, joint_rig
from vergence.controllers.prediction.memory import (
    ANGLES,
    COUNT,
    DELAY,
    GOALS,
    IMAGES,
    PRESENT_LAG,
    SIZE,
    UNSEEN,
    VELOCITY,
    initial_row,
    track,
)
from vergence.envs.layout import Observation, ObservationLayout
from vergence.errors import ConfigurationError
from vergence.models.head import HeadModel
from vergence.models.parts import FloatArray

HOLD_S: Final = 0.5
"""How long the goal of an eye that does not see is held."""


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
            finds the delay on line, see `vergence.controllers.prediction.delay`.
        lag: the same of the joints' lag, see `vergence.controllers.prediction.joints`.

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
        return SIZE

    def initial(self) -> FloatArray:
        """(size,) the state before the first observation."""
        return initial_row(self.rig)

    def update(self, seen: Observation, state: FloatArray) -> Prediction:
        """Take one control period's observation.

        Args:
            seen: the observation of some heads.
            state: (..., size or more) their states, changed in place; C-contiguous float64.
                What follows a state in its row is the caller's, and stays as it is.

        Returns:
            What is left to turn at present.
        """
        leading = state.shape[:-1]
        rows = state.reshape(-1, state.shape[-1])
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
            (rows[:, DELAY] * self.rig[PERIOD]).reshape(leading),
            known.reshape(*leading, 2),
            now.reshape(*leading, 4),
            speed.reshape(*leading, 4),
            rows[:, PRESENT_LAG].reshape(leading).copy(),
        )

    def angles_at_exposure(self, state: FloatArray) -> FloatArray:
        """The eyes' angles at the exposure of an image that has just come, by the present delay.

        Args:
            state: (..., size or more) after `update`.

        Returns:
            (..., 4) rad.
        """
        rows = state.reshape(-1, state.shape[-1])
        slots = (rows[:, COUNT].astype(np.int64) - 1 - rows[:, DELAY].astype(np.int64)) % RING
        rings = rows[:, ANGLES:IMAGES].reshape(-1, RING, 4)
        return rings[np.arange(len(rows)), slots].reshape(*state.shape[:-1], 4)


@compiled
def _update(
    rows: Any, positions: Any, velocities: Any, command: Any, age: Any, error: Any, rig: Any,
    p: Any, learn_delay: bool, learn_lags: bool, to_go: Any, pixel_error: Any, known: Any,
    now: Any, speed: Any,
) -> None:  # fmt: skip
    hold = round(HOLD_S / rig[PERIOD])
    for n in range(rows.shape[0]):
        row = rows[n]
        track(row, positions[n], velocities[n], command[n], rig, learn_lags)
        fresh = abs(age[n] - rig[LATENCY]) < 0.5 * rig[PERIOD]
        for eye in range(2):
            row[UNSEEN + eye] += 1.0
            if fresh and isfinite(error[n, eye, 0]) and isfinite(error[n, eye, 1]):
                row[UNSEEN + eye] = 0.0
        if fresh and (row[UNSEEN] == 0.0 or row[UNSEEN + 1] == 0.0):
            take_image(row, error[n], rig, p, learn_delay)
        slot = ANGLES + 4 * ((int(row[COUNT]) - 1) % RING)
        for j in range(4):
            now[n, j], speed[n, j] = row[slot + j], row[VELOCITY + j]
        for eye in range(2):
            if row[UNSEEN + eye] > hold:
                row[GOALS + 2 * eye] = row[GOALS + 2 * eye + 1] = nan
            t = 2 * eye
            known[n, eye] = isfinite(row[GOALS + t])
            to_go[n, t], to_go[n, t + 1], pixel_error[n, eye, 0], pixel_error[n, eye, 1] = (
                present_of(row, rig, p, eye, now[n, t], now[n, t + 1])
            )
