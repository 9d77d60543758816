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
    origin: FloatArray = field(default_factory=lambda: np.zeros(3))
    ray: FloatArray = field(default_factory=lambda: np.zeros(3))
    """Line of sight in frame 0, of length 1."""
    turn: FloatArray = field(default_factory=lambda: np.zeros(3))
    """Its change, 1/s."""
    size_px: float | None = None
    id: object = None
    others: list[tuple[float, FloatArray]] = field(default_factory=list)
    """Time and line of sight of candidates that were not the target."""


class Identity:
    """Chooses one target among both eyes' candidates; the eyes may call it from two threads.

    Args:
        cameras: the left and the right eye's camera.

    Attributes:
        refused: number of jumps to another object that were refused.
    """

    def __init__(self, cameras: Sequence[Camera]) -> None:
        self._cameras = cameras
        self._lock = threading.Lock()
        self.refused = 0
        self.forget()

    def forget(self) -> None:
        """Drop the target and all that was seen."""
        self._eyes = (_Seen(), _Seen())
        self._depth_m = _DEPTH_M
        self._refusing = False

    def hint(self, eye: int, T_0_C: FloatArray, time_s: float) -> FloatArray | None:
        """(2,) pixel at which an eye will see the target; None if it is unknown.

        Args:
            eye: 0 for left, 1 for right.
            T_0_C: (4, 4) pose of the camera at the exposure, m.
            time_s: time of the exposure, s.
        """
        with self._lock:
            return self._predict(eye, T_0_C, time_s)

    def post(
        self, eye: int, candidates: Sequence[Detection], T_0_C: FloatArray, time_s: float
    ) -> None:
        """Add the candidates of an eye's image; for the other arguments see `hint`."""
        with self._lock:
            seen = self._eyes[eye]
            seen.candidates, seen.T_0_C, seen.time_s = list(candidates), T_0_C, time_s

    def waits(self, eye: int) -> bool:
        """True if nothing can be chosen until the other eye has been heard."""
        with self._lock:
            own, other = self._eyes[eye], self._eyes[1 - eye]
            unknown = own.time_s - max(own.chosen_s, other.chosen_s) > _HOLD_S
            return unknown and bool(own.candidates) and own.time_s - other.time_s > _HOLD_S

    def choose(self, eye: int) -> Detection | None:
        """The target among the candidates posted last; None if it is not there."""
        with self._lock:
            own, other = self._eyes[eye], self._eyes[1 - eye]
            now = own.time_s
            tracked_s = max(own.chosen_s, other.chosen_s)
            if now - tracked_s > _HOLD_S:
                found = self._acquire(eye)
            else:
                found = self._continue(eye) or self._as_other(eye) or self._moved(eye)
            if found is not None:
                self._keep(eye, found)
            return found

    def _predict(self, eye: int, T_0_C: FloatArray, time_s: float) -> FloatArray | None:
        own, other = self._eyes[eye], self._eyes[1 - eye]
        seen = own if own.chosen_s >= other.chosen_s - _HOLD_S else other
        lead_s = time_s - seen.chosen_s
        if not lead_s <= _HOLD_S:
            return None
        lead_s = float(np.clip(lead_s, -_LEAD_S, _LEAD_S))
        point = seen.origin + self._depth_m * (seen.ray + lead_s * seen.turn)
        pixel = self._project(eye, T_0_C, point)
        return pixel if np.isfinite(pixel).all() else None

    def _project(self, eye: int, T_0_C: FloatArray, point: FloatArray) -> FloatArray:
        in_eye = T_0_C[:3, :3].T @ (point - T_0_C[:3, 3])
        return np.asarray(self._cameras[eye].project(in_eye[None])[0])

    def _line(self, eye: int, pixel: FloatArray) -> FloatArray:
        """Line of sight of a pixel in frame 0, of length 1."""
        ray = np.append(self._cameras[eye].rays(np.asarray(pixel, float)[None])[0], 1.0)
        ray = self._eyes[eye].T_0_C[:3, :3] @ ray
        return np.asarray(ray / np.linalg.norm(ray))

    def _agreement(self, one: Detection, other: Detection) -> float | None:
        """Depth at which a left and a right candidate are one object; None if they are two."""
        left, right = self._eyes
        rays = self._line(0, one.pixel), self._line(1, other.pixel)
        origins = left.T_0_C[:3, 3], right.T_0_C[:3, 3]
        apart = origins[0] - origins[1]
        # depths of the closest approach of two lines, Eqs. 18 to 23
        cosine = float(rays[0] @ rays[1])
        down = 1.0 - cosine**2
        if down < 1e-9:
            return None
        along = float(rays[0] @ apart), float(rays[1] @ apart)
        depths = (cosine * along[1] - along[0]) / down, (along[1] - cosine * along[0]) / down
        if not all(_DEPTH_RANGE_M[0] < depth < _DEPTH_RANGE_M[1] for depth in depths):
            return None
        points = [origins[i] + depths[i] * rays[i] for i in range(2)]
        middle = 0.5 * (points[0] + points[1])
        tolerance = _AGREE_PX + _AGREE_PX_S * abs(left.time_s - right.time_s)
        for eye, (candidate, seen) in enumerate(zip((one, other), self._eyes, strict=True)):
            off = self._project(eye, seen.T_0_C, middle) - candidate.pixel
            if not np.linalg.norm(off) <= tolerance + 3.0 * float(np.max(candidate.sigma_px)):
                return None
        focal = [float(camera.focal.mean()) for camera in self._cameras]
        sizes = [
            None if each.size_px is None else each.size_px * depth / f
            for each, depth, f in zip((one, other), depths, focal, strict=True)
        ]
        return depths[0] if _alike(*sizes) else None

    def _pairs(
        self, eye: int, others: Sequence[Detection] | None = None
    ) -> list[tuple[float, Detection, float]]:
        """Score, own candidate and depth of all pairs of candidates on which both eyes agree.

        `others` are the other eye's candidates that count; None for all.
        """
        pairs = []
        by_eye = [list(seen.candidates) for seen in self._eyes]
        if others is not None:
            by_eye[1 - eye] = list(others)
        for one, other in product(*by_eye):
            depth_m = self._agreement(one, other)
            if depth_m is not None:
                pairs.append((one.score * other.score, other if eye else one, depth_m))
        return pairs

    def _acquire(self, eye: int) -> Detection | None:
        """The best candidate on which both eyes agree, or of one eye if the other sees none."""
        own, other = self._eyes[eye], self._eyes[1 - eye]
        self._refusing = False
        if not own.candidates or own.time_s - other.time_s > _HOLD_S:
            return None
        if not other.candidates:
            self._depth_m = _DEPTH_M
            return max(own.candidates, key=lambda one: one.score)
        pairs = self._pairs(eye)
        if not pairs:
            return None
        _score, found, self._depth_m = max(pairs, key=lambda pair: pair[0])
        return found

    def _continue(self, eye: int) -> Detection | None:
        """The candidate nearest to the prediction, if it is near enough and both eyes agree."""
        own, other = self._eyes[eye], self._eyes[1 - eye]
        predicted = self._predict(eye, own.T_0_C, own.time_s)
        candidates = list(own.candidates)
        name = own.id if own.id is not None else other.id
        if name is not None and any(one.id == name for one in candidates):
            candidates = [one for one in candidates if one.id == name]
            predicted = None
        if own.chosen_s == -np.inf:
            return None
        since_s = own.time_s - own.chosen_s
        focal_px = float(self._cameras[eye].focal.mean())
        close = _GATE_PX + _GATE_SIZES * (own.size_px or 0.0)
        gate = close + min(_GATE_RAD_S * since_s, _MOST_GATE_RAD) * focal_px
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
        in_newest = other.chosen is not None and other.chosen_s == other.time_s
        if not in_newest or abs(own.time_s - other.time_s) > _TOGETHER_S:
            return None
        assert other.chosen is not None
        pairs = self._pairs(eye, [other.chosen])
        return max(pairs, key=lambda pair: pair[0])[1] if pairs else None

    def _moved(self, eye: int) -> Detection | None:
        """A candidate at a new place that is the target, moved; counts a jump to another object."""
        own = self._eyes[eye]
        if not own.candidates:
            return None
        pairs = [pair for pair in self._pairs(eye) if not self._is_other(eye, pair[1])]
        pairs = [pair for pair in pairs if _alike(pair[1].size_px, own.size_px)]
        if len(pairs) == 1:
            _score, found, self._depth_m = pairs[0]
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
        own.chosen, own.chosen_s, own.size_px, own.id = found, now, found.size_px, found.id
        own.others = [one for one in own.others if now - one[0] < _MEMORY_S]
        own.others += [
            (now, self._line(eye, one.pixel)) for one in own.candidates if one is not found
        ]
        self._refusing = False
        for _score, one, depth_m in self._pairs(eye):
            if one is found:
                self._depth_m = depth_m


def _alike(one: float | None, other: float | None) -> bool:
    """True if two sizes may be of one object; so may unknown ones."""
    return one is None or other is None or max(one, other) <= _SIZE_RATIO * min(one, other)
