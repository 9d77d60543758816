"""Identity of an object over time and between both eyes.

Of several candidates the one nearest to the predicted pixel stays the target. Both eyes must agree:
the two lines of sight pass each other within a few pixels, in front of both eyes, and the sizes
match. A jump to another object is refused for half a second; a target that has moved quickly is
none if nothing remains at its place, both eyes see it at one new place, and nothing was seen there
before.
"""

import threading
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import product
from typing import Final

import numpy as np

from vergence.models.camera import Camera
from vergence.models.parts import FloatArray
from vergence.vision.detection import Detection
from vergence.vision.objects.sights import crossing, line_of_sight, pixel_of

_HOLD_S: Final = 0.5
"""Time for which a jump to another object is refused, s (chosen: a person who passes by)."""
_AGREE_PX: Final = 6.0
"""Greatest distance of the lines of sight that both eyes agree on, px (chosen: errors of encoders
and calibration)."""
_AGREE_PX_S: Final = 120.0
"""The same for each second between the two exposures, px/s (chosen: objects that move)."""
_DEPTH_RANGE_M: Final = (0.08, 100.0)
"""Range of depths of an object, m (chosen: what a head may look at)."""
_TOGETHER_S: Final = 0.15
"""Time between two images in which both eyes may name one object, s (chosen: a slow detector)."""
_SIZE_RATIO: Final = 1.6
"""Greatest ratio of the sizes of one object (chosen: a detector's scatter, a tilted view)."""
_GATE_PX: Final = 14.0
"""Least distance from the prediction at which a candidate counts as a jump, px (chosen)."""
_GATE_RAD_S: Final = 3.0
"""Growth of this distance for each second since the last sighting, rad/s (chosen: quick hands)."""
_MOST_GATE_RAD: Final = 0.15
"""Most of this growth, rad (chosen: below the distance between two persons at arm's length)."""
_GATE_SIZES: Final = 0.5
"""Part of it in sizes of the object (chosen: a box that breathes)."""
_LEAD_S: Final = 0.25
"""Longest time over which a motion is extrapolated, s (chosen)."""
_MEMORY_S: Final = 1.0
"""Time for which the other candidates are remembered, s (chosen)."""
_DEPTH_M: Final = 1.0
"""Depth of what one eye alone has seen, m (chosen: a usual working distance)."""


@dataclass
class _Seen:
    """The newest image of one eye, and the target as it was seen last."""

    candidates: Sequence[Detection] = ()
    T_0_C: FloatArray = field(default_factory=lambda: np.eye(4))
    time_s: float = -np.inf
    chosen: Detection | None = None
    chosen_s: float = -np.inf
    """Time of the last sighting, s."""
    missed_s: float = -np.inf
    """Time of the first image after it, s; that of the sighting if there is none."""
    origin: FloatArray = field(default_factory=lambda: np.zeros(3))
    ray: FloatArray = field(default_factory=lambda: np.zeros(3))
    """Line of sight in frame 0, of length 1."""
    turn: FloatArray = field(default_factory=lambda: np.zeros(3))
    """Its change, 1/s."""
    others: list[tuple[float, FloatArray]] = field(default_factory=list)
    """Time and line of sight of candidates that were not the target."""

    @property
    def size_px(self) -> float | None:
        return None if self.chosen is None else self.chosen.size_px


class Identity:
    """Chooses one target among both eyes' candidates; the eyes may call it from two threads.

    Args:
        cameras: the left and the right eye's camera.

    Attributes:
        refused: number of jumps to another object that were refused.
        offered: numbers of images of each eye with candidates.
        taken: numbers of images of each eye in which one was the target.
        depth_m: depth of the target, m.
    """

    def __init__(self, cameras: Sequence[Camera]) -> None:
        self._cameras = cameras
        self._lock = threading.Lock()
        self.refused = 0
        self.offered, self.taken = [0, 0], [0, 0]
        self.forget()

    def forget(self) -> None:
        """Drop the target and all that was seen."""
        with self._lock:
            self._eyes = (_Seen(), _Seen())
            self.depth_m = _DEPTH_M
            self._refusing = False

    def hint(self, eye: int, T_0_C: FloatArray, time_s: float) -> FloatArray | None:
        """(2,) pixel at which an eye will see the target; None if it is unknown.

        Args:
            eye: 0 for left, 1 for right.
            T_0_C: (4, 4) pose of the camera at the exposure, m.
            time_s: time of the exposure, s.
        """
        with self._lock:
            return None if self._unknown(eye) else self._predict(eye, T_0_C, time_s)

    def post(
        self, eye: int, candidates: Sequence[Detection], T_0_C: FloatArray, time_s: float
    ) -> None:
        """Add the candidates of an eye's image; for the other arguments see `hint`."""
        with self._lock:
            seen = self._eyes[eye]
            if seen.missed_s == seen.chosen_s > -np.inf:
                seen.missed_s = time_s
            seen.candidates, seen.T_0_C, seen.time_s = list(candidates), T_0_C, time_s
            self.offered[eye] += bool(candidates)

    def waits(self, eye: int) -> bool:
        """True if nothing can be chosen until the other eye has been heard."""
        with self._lock:
            own, other = self._eyes[eye], self._eyes[1 - eye]
            return (
                self._unknown(eye) and bool(own.candidates) and own.time_s - other.time_s > _HOLD_S
            )

    def choose(self, eye: int) -> Detection | None:
        """The target among the candidates posted last; None if it is not there."""
        with self._lock:
            if self._unknown(eye):
                found = self._acquire(eye)
            else:
                found = self._continue(eye) or self._as_other(eye) or self._moved(eye)
            if found is not None:
                self.taken[eye] += 1
                self._keep(eye, found)
            return found

    def _unknown(self, eye: int) -> bool:
        """True if there is no target, or images have been without it for long enough."""
        missed_s = max(seen.missed_s for seen in self._eyes)
        return self._eyes[eye].time_s - missed_s > _HOLD_S or missed_s == -np.inf

    def _predict(self, eye: int, T_0_C: FloatArray, time_s: float) -> FloatArray | None:
        own, other = self._eyes[eye], self._eyes[1 - eye]
        seen = own if own.chosen_s >= other.chosen_s - _HOLD_S else other
        lead_s = time_s - seen.chosen_s
        if lead_s == np.inf:
            return None
        lead_s = float(np.clip(lead_s, -_LEAD_S, _LEAD_S))
        point = seen.origin + self.depth_m * (seen.ray + lead_s * seen.turn)
        pixel = pixel_of(self._cameras[eye], T_0_C, point)
        return pixel if np.isfinite(pixel).all() else None

    def _line(self, eye: int, pixel: FloatArray) -> FloatArray:
        """Line of sight of a pixel in frame 0, of length 1."""
        return line_of_sight(self._cameras[eye], self._eyes[eye].T_0_C, np.asarray(pixel, float))

    def _agreement(self, one: Detection, other: Detection) -> float | None:
        """Depth at which a left and a right candidate are one object; None if they are two."""
        left, right = self._eyes
        depths, middle = crossing(
            (left.T_0_C[:3, 3], right.T_0_C[:3, 3]),
            (self._line(0, one.pixel), self._line(1, other.pixel)),
        )
        if not ((depths > _DEPTH_RANGE_M[0]) & (depths < _DEPTH_RANGE_M[1])).all():
            return None
        tolerance = _AGREE_PX + _AGREE_PX_S * abs(left.time_s - right.time_s)
        for eye, (candidate, seen) in enumerate(zip((one, other), self._eyes, strict=True)):
            off = pixel_of(self._cameras[eye], seen.T_0_C, middle) - candidate.pixel
            if not np.linalg.norm(off) <= tolerance + 3.0 * float(np.max(candidate.sigma_px)):
                return None
        sizes_m = [
            None if each.size_px is None else each.size_px * depth / float(camera.focal.mean())
            for each, depth, camera in zip((one, other), depths, self._cameras, strict=True)
        ]
        return float(depths[0]) if _alike(*sizes_m) else None

    def _pairs(
        self, eye: int, others: Sequence[Detection] | None = None
    ) -> list[tuple[float, Detection, float]]:
        """Score, own candidate and depth of all pairs on which both eyes agree, with `others`."""
        pairs = []
        others = self._eyes[1 - eye].candidates if others is None else others
        for own, other in product(self._eyes[eye].candidates, others):
            depth_m = self._agreement(*((other, own) if eye else (own, other)))
            if depth_m is not None:
                pairs.append((own.score * other.score, own, depth_m))
        return pairs

    def _acquire(self, eye: int) -> Detection | None:
        """The best candidate on which both eyes agree, or of one eye if the other sees none."""
        own, other = self._eyes[eye], self._eyes[1 - eye]
        self._refusing = False
        if not own.candidates or own.time_s - other.time_s > _HOLD_S:
            return None
        if not other.candidates:
            self.depth_m = _DEPTH_M
            return max(own.candidates, key=lambda one: one.score)
        best = max(self._pairs(eye), key=lambda pair: pair[0], default=None)
        if best is None:
            return None
        _score, found, self.depth_m = best
        return found

    def _continue(self, eye: int) -> Detection | None:
        """The candidate nearest to the prediction, if it is near enough and both eyes agree."""
        own, other = self._eyes[eye], self._eyes[1 - eye]
        if own.chosen is None:
            return None
        predicted = self._predict(eye, own.T_0_C, own.time_s)
        candidates = own.candidates
        name = own.chosen.id
        if name is None and other.chosen is not None:
            name = other.chosen.id
        named = [one for one in candidates if name is not None and one.id == name]
        if named:
            candidates, predicted = named, None
        close = _GATE_PX + _GATE_SIZES * (own.size_px or 0.0)
        grown = min(_GATE_RAD_S * (own.time_s - own.chosen_s), _MOST_GATE_RAD)
        gate = close + grown * float(self._cameras[eye].focal.mean())
        near = []
        for one in candidates:
            away = 0.0 if predicted is None else float(np.linalg.norm(one.pixel - predicted))
            reach = close if self._is_other(eye, one) else gate
            reach += 3.0 * float(np.max(one.sigma_px))
            if away <= reach and _alike(one.size_px, own.size_px):
                near.append((away, one))
        return min(near, key=lambda pair: pair[0])[1] if near else None

    def _as_other(self, eye: int) -> Detection | None:
        """The best candidate on the line of sight to what the other eye has just chosen."""
        own, other = self._eyes[eye], self._eyes[1 - eye]
        together = abs(own.time_s - other.time_s) <= _TOGETHER_S
        if other.chosen is None or other.chosen_s != other.time_s or not together:
            return None
        pairs = self._pairs(eye, [other.chosen])
        return max(pairs, key=lambda pair: pair[0])[1] if pairs else None

    def _moved(self, eye: int) -> Detection | None:
        """A candidate at a new place that is the target, moved; counts a jump to another object."""
        own = self._eyes[eye]
        if not own.candidates:
            return None
        pairs = [
            pair for pair in self._pairs(eye)
            if not self._is_other(eye, pair[1]) and _alike(pair[1].size_px, own.size_px)
        ]  # fmt: skip
        if len(pairs) == 1:
            _score, found, self.depth_m = pairs[0]
            return found
        known = [one for one in own.candidates if self._is_other(eye, one)]
        own.others += [(own.time_s, self._line(eye, one.pixel)) for one in known]
        if len(known) == len(own.candidates) and not self._refusing:
            self._refusing = True
            self.refused += 1
        return None

    def _is_other(self, eye: int, candidate: Detection) -> bool:
        """True if a candidate was seen before beside the target."""
        ray = self._line(eye, candidate.pixel)
        focal_px = float(self._cameras[eye].focal.mean())
        return any(
            focal_px * float(np.linalg.norm(ray - line)) < 2.0 * _GATE_PX
            for _time_s, line in self._eyes[eye].others
        )

    def _keep(self, eye: int, found: Detection) -> None:
        """Take a candidate for the target, and remember the others."""
        own, now = self._eyes[eye], self._eyes[eye].time_s
        ray = self._line(eye, found.pixel)
        since_s = now - own.chosen_s
        turn = (ray - own.ray) / since_s if 1e-4 < since_s < _LEAD_S else np.zeros(3)
        own.turn = 0.5 * (own.turn + turn) if np.isfinite(since_s) else turn
        own.origin, own.ray = own.T_0_C[:3, 3].copy(), ray
        own.chosen, own.chosen_s, own.missed_s = found, now, now
        own.others = [one for one in own.others if now - one[0] < _MEMORY_S]
        own.others += [
            (now, self._line(eye, one.pixel)) for one in own.candidates if one is not found
        ]
        self._refusing = False
        for _score, one, depth_m in self._pairs(eye):
            if one is found:
                self.depth_m = depth_m


def _alike(one: float | None, other: float | None) -> bool:
    """True if two sizes may be of one object; so may unknown ones."""
    return one is None or other is None or max(one, other) <= _SIZE_RATIO * min(one, other)
