"""Errors of joint angles' readings that follow a rule: play, and encoder discs off their axes.

    true angle = reading + error + sum_k rule_k(readings; y_k)

with a number y each, in rad, of an actuator. With play the joint stays behind the motor, whose
angle is read, until the motor has crossed it: y is its whole width. An encoder disc that is
not centred reads an angle q wrong by harmonics, y cos(q), y sin(q), y cos(2q) and y sin(2q), of the
eyes less its mean over the recording, which is a joint's offset. (The neck's joints have none.)
"""

from collections.abc import Collection
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from vergence.calibration.head.frames import POSE_RAD, HeadFrames
from vergence.models.head import HeadModel
from vergence.models.joints import NECK
from vergence.models.parts import FloatArray

IntArray = NDArray[np.intp]
_SPREADS: Final = {"play": np.deg2rad(0.5), "harmonics": np.deg2rad(0.3)}
"""Deviations of the numbers before any image, rad: gears of hobby servos, a disc of 20 mm that is
0.05 mm off its axis."""
RULES: Final = tuple(_SPREADS)
"""Kinds of rules."""
_HARMONICS: Final = {"cos1": (1, np.cos), "sin1": (1, np.sin), "cos2": (2, np.cos),
                     "sin2": (2, np.sin)}  # fmt: skip


@dataclass(frozen=True, kw_only=True, eq=False)
class ReadingTerms:
    """Rules of some frames' readings, and what is known of their numbers."""

    names: tuple[str, ...] = ()
    """(t,) such as `left_pan.play` and `left_pan.cos1`."""
    joint: IntArray
    """(t,) the actuator of each, of the neck's three joints and the eyes' four actuators."""
    nominal: FloatArray
    """(t,) the numbers as they were believed, rad."""
    sigma: FloatArray
    """(t,) their deviations, rad; 0 for those that are held."""
    readings: FloatArray
    """(F, 7) the actuators' angles, rad, in all frames in the order of time."""
    frames: IntArray
    """(f,) those in question."""
    centre: FloatArray
    """(t,) the mean of each harmonic of the eyes; 0 for others."""

    @classmethod
    def of_frames(
        cls, head: HeadModel, frames: HeadFrames, kinds: Collection[str]
    ) -> "ReadingTerms":
        """Rules of all actuators that move.

        Args:
            head: whose actuators.
            frames: in the order of time.
            kinds: some of `RULES`.
        """
        readings = head.actuation.actuators_of(frames.positions)
        every = np.arange(len(readings))
        return replace(NO_TERMS, readings=readings, frames=every).with_rules(head, kinds)

    def with_rules(self, head: HeadModel, kinds: Collection[str]) -> "ReadingTerms":
        """Other rules of the same readings, see `of_frames`."""
        own, readings = head.actuation, self.readings
        moves = (own.upper > own.lower) & (np.ptp(readings, axis=0) > POSE_RAD)
        names, joint, sigma = [], [], []
        for kind in RULES:
            for each in np.flatnonzero(moves).tolist() if kind in kinds else ():
                parts = ["play"] if kind == "play" else list(_HARMONICS)
                names += [f"{[*head.joints[:3], *own.names][each]}.{part}" for part in parts]
                joint += [each] * len(parts)
                sigma += [_SPREADS[kind]] * len(parts)
        waves = [_harmonic(name, readings[:, k]) for name, k in zip(names, joint, strict=True)]
        return replace(
            self,
            names=tuple(names),
            joint=np.array(joint, dtype=np.intp),
            nominal=np.zeros(len(names)),
            sigma=np.array(sigma, dtype=np.float64),
            centre=np.array([wave.mean() for wave in waves]) * (np.array(joint) >= NECK.stop),
        )

    @property
    def kinds(self) -> tuple[str, ...]:
        """(t,) of `RULES`."""
        return tuple("play" if name.endswith(".play") else "harmonics" for name in self.names)

    @property
    def plays(self) -> NDArray[np.bool_]:
        """(t,) which numbers are plays."""
        return np.array([kind == "play" for kind in self.kinds], dtype=np.bool_)

    def of(self, frames: NDArray[np.bool_]) -> "ReadingTerms":
        """Those of some of the frames."""
        return self if self is NO_TERMS else replace(self, frames=self.frames[frames])

    def held(self, values: FloatArray) -> "ReadingTerms":
        """With numbers (t,) that stay what they are."""
        return replace(self, nominal=values, sigma=np.zeros(len(values)))

    def at(self, values: FloatArray) -> tuple[FloatArray, FloatArray]:
        """What the rules add to the readings.

        Args:
            values: (t,) their numbers, rad.

        Returns:
            (f, 7) rad by actuator, and its derivatives (f, t) by the number, each of its actuator.
        """
        angles = self.readings[:, self.joint]
        by = np.zeros_like(angles)
        for column, name in enumerate(self.names):
            by[:, column] = _harmonic(name, angles[:, column]) - self.centre[column]
        added, plays = by * values, self.plays
        added[:, plays], by[:, plays] = _behind(angles[:, plays], values[plays])
        return added[self.frames] @ np.eye(7)[self.joint], by[self.frames]

    def tangent(self, values: FloatArray, others: FloatArray) -> FloatArray:
        """(f, 7) what the rules add with other numbers, to first order from given ones."""
        added, by = self.at(values)
        return added + (by * (others - values)) @ np.eye(7)[self.joint]


NO_TERMS: Final = ReadingTerms(
    joint=np.zeros(0, dtype=np.intp), nominal=np.zeros(0), sigma=np.zeros(0),
    readings=np.zeros((1, 7)), frames=np.zeros(1, dtype=np.intp), centre=np.zeros(0),
)  # fmt: skip


def _harmonic(name: str, angles: FloatArray) -> FloatArray:
    """(F,) the harmonic of angles (F,) that a number is the factor of; 0 for play."""
    order, function = _HARMONICS.get(name.rpartition(".")[2], (0, np.sin))
    return np.asarray(function(order * angles))


def _behind(angles: FloatArray, width: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(F, k) how far joints are from motors (F, k) with play (k,), and the derivatives by it.

    In the middle of it at first. A width below 0 is that above 0 the other way round.
    """
    half = 0.5 * np.abs(width)
    away, by = np.zeros_like(angles), np.zeros_like(angles)
    for frame in range(1, len(angles)):
        free = away[frame - 1] - (angles[frame] - angles[frame - 1])
        away[frame] = np.clip(free, -half, half)
        by[frame] = np.where(np.abs(free) > half, 0.5 * np.sign(free), by[frame - 1])
    return np.where(width < 0.0, -away, away), by
