"""Reading-error terms, systematic errors of joint readings: backlash, eccentric encoder discs.

    true angle = reading + error + sum_k term_k(readings; y_k)

Each term belongs to an actuator and has one parameter y, in rad. With backlash (play), the joint
lags behind the motor, whose angle is read, until the motor has crossed the gap: y is its whole
width. An eccentric encoder disc causes harmonics of the angle q: y cos(q), y sin(q), y cos(2q) and
y sin(2q). The eyes' harmonics have zero mean over the recording, as a mean is a joint's offset.
(The neck's joints have no offset among the parameters.)
"""

from collections.abc import Collection
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from vergence.calibration.head.recording import SAME_POSE_RAD, HeadFrames
from vergence.models.head import HeadModel
from vergence.models.parts import NECK, FloatArray

IntArray = NDArray[np.intp]
_PRIOR_SIGMA: Final = {"play": np.deg2rad(0.5), "harmonics": np.deg2rad(0.3)}
"""Prior standard deviations of the parameters, rad (chosen: gears of hobby servos, and a disc of
20 mm that is 0.05 mm off its axis)."""
TERM_KINDS: Final = tuple(_PRIOR_SIGMA)
"""Kinds of reading-error terms."""
_HARMONICS: Final = {"cos1": (1, np.cos), "sin1": (1, np.sin), "cos2": (2, np.cos),
                     "sin2": (2, np.sin)}  # fmt: skip


@dataclass(frozen=True, kw_only=True, eq=False)
class ReadingErrorTerms:
    """Terms that model systematic reading errors: backlash, and harmonics of the encoders."""

    names: tuple[str, ...] = ()
    """(t,) names such as `left_pan.play` and `left_pan.cos1`."""
    actuator_index: IntArray
    """(t,) actuator of each term, of the neck's three joints and the eyes' four actuators."""
    prior_mean: FloatArray
    """(t,) prior means of the parameters, rad."""
    prior_sigma: FloatArray
    """(t,) prior standard deviations of the parameters, rad; 0 for fixed ones."""
    actuator_readings: FloatArray
    """(F, 7) the actuators' angles, rad, in all frames in the order of time."""
    frame_index: IntArray
    """(f,) indices of the selected frames."""
    harmonic_mean: FloatArray
    """(t,) mean of each harmonic of the eyes over all frames; 0 for other terms."""

    @classmethod
    def of_frames(
        cls, head: HeadModel, frames: HeadFrames, kinds: Collection[str]
    ) -> "ReadingErrorTerms":
        """Make terms of some `TERM_KINDS` for all actuators that move, frames in time."""
        readings = head.actuation.actuators_of(frames.joint_positions)
        every = np.arange(len(readings))
        return replace(NO_TERMS, actuator_readings=readings, frame_index=every).with_terms(
            head, kinds
        )

    def with_terms(self, head: HeadModel, kinds: Collection[str]) -> "ReadingErrorTerms":
        """Make other terms for the same readings, see `of_frames`."""
        own, readings = head.actuation, self.actuator_readings
        moves = (own.upper > own.lower) & (np.ptp(readings, axis=0) > SAME_POSE_RAD)
        names, joint, sigma = [], [], []
        for kind in TERM_KINDS:
            for each in np.flatnonzero(moves).tolist() if kind in kinds else ():
                parts = ["play"] if kind == "play" else list(_HARMONICS)
                names += [f"{[*head.joints[:3], *own.names][each]}.{part}" for part in parts]
                joint += [each] * len(parts)
                sigma += [_PRIOR_SIGMA[kind]] * len(parts)
        waves = [_harmonic(name, readings[:, k]) for name, k in zip(names, joint, strict=True)]
        return replace(
            self,
            names=tuple(names),
            actuator_index=np.array(joint, dtype=np.intp),
            prior_mean=np.zeros(len(names)),
            prior_sigma=np.array(sigma, dtype=np.float64),
            harmonic_mean=np.array([wave.mean() for wave in waves])
            * (np.array(joint) >= NECK.stop),
        )

    @property
    def kinds(self) -> tuple[str, ...]:
        """(t,) kind of each term, one of `TERM_KINDS`."""
        return tuple("play" if name.endswith(".play") else "harmonics" for name in self.names)

    @property
    def is_backlash(self) -> NDArray[np.bool_]:
        """(t,) True for backlash."""
        return np.array([kind == "play" for kind in self.kinds], dtype=np.bool_)

    def select(self, frames: NDArray[np.bool_]) -> "ReadingErrorTerms":
        """Select some of the frames."""
        return self if self is NO_TERMS else replace(self, frame_index=self.frame_index[frames])

    def fixed_at(self, values: FloatArray) -> "ReadingErrorTerms":
        """Fix the parameters at values (t,)."""
        return replace(self, prior_mean=values, prior_sigma=np.zeros(len(values)))

    def evaluate(self, values: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Evaluate the terms, which add to the readings.

        Args:
            values: (t,) their parameters, rad.

        Returns:
            (f, 7) sum of the terms by actuator, rad, and (f, t) derivative of each term's actuator
            angle by its parameter.
        """
        angles = self.actuator_readings[:, self.actuator_index]
        by = np.zeros_like(angles)
        for column, name in enumerate(self.names):
            by[:, column] = _harmonic(name, angles[:, column]) - self.harmonic_mean[column]
        added, is_backlash = by * values, self.is_backlash
        added[:, is_backlash], by[:, is_backlash] = _backlash_offset(
            angles[:, is_backlash], values[is_backlash]
        )
        return added[self.frame_index] @ np.eye(7)[self.actuator_index], by[self.frame_index]

    def linearised_sum(self, values: FloatArray, other_values: FloatArray) -> FloatArray:
        """(f, 7) sum of the terms with other parameters, linearised at given ones."""
        added, by = self.evaluate(values)
        return added + (by * (other_values - values)) @ np.eye(7)[self.actuator_index]


NO_TERMS: Final = ReadingErrorTerms(
    actuator_index=np.zeros(0, dtype=np.intp), prior_mean=np.zeros(0), prior_sigma=np.zeros(0),
    actuator_readings=np.zeros((1, 7)), frame_index=np.zeros(1, dtype=np.intp),
    harmonic_mean=np.zeros(0),
)  # fmt: skip


def _harmonic(name: str, angles: FloatArray) -> FloatArray:
    """(F,) harmonic of angles (F,) that a parameter multiplies; 0 for backlash."""
    order, function = _HARMONICS.get(name.rpartition(".")[2], (0, np.sin))
    return np.asarray(function(order * angles))


def _backlash_offset(angles: FloatArray, width: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(F, k) offsets of joints from motors, and by width (k,); the first frame is in the middle."""
    half = 0.5 * np.abs(width)
    away, by = np.zeros_like(angles), np.zeros_like(angles)
    for frame in range(1, len(angles)):
        free = away[frame - 1] - (angles[frame] - angles[frame - 1])
        away[frame] = np.clip(free, -half, half)
        by[frame] = np.where(np.abs(free) > half, 0.5 * np.sign(free), by[frame - 1])
    return np.where(width < 0.0, -away, away), by
