"""Compare the measured length of a target's edges with the stated one, and explain a difference."""

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from vergence.models.head import HeadModel
from vergence.models.parts import EYES, FloatArray
from vergence.perception.photographs import join_first_names
from vergence.perception.spacing import MM, neighbour_pairs, stated_edge_m
from vergence.triangulation import Noise, triangulate_views
from vergence.vision.targets import PlanarTarget

_SIGNIFICANT_SIGMAS: Final = 3.0
"""Standard deviations above which a difference is significant (chosen: false against missed
remarks)."""
_MIN_RELATIVE_DIFFERENCE: Final = 0.01
"""Smallest difference that is remarked on, as a fraction of the stated edge; good calibrations and
printers err by less (chosen: as above)."""
_UNIT_RATIO_TOLERANCE: Final = 0.05
"""Relative tolerance within which a ratio of lengths suggests a mistaken unit (chosen: mistakes
recognised against coincidence)."""
_UNIT_MISTAKE_HINTS: Final = {
    1000.0: "was the size given in m, or the head's lengths in mm?",
    100.0: "were the head's lengths given in cm?",
    39.37: "were the head's lengths given in inches?",
    25.4: "was the size given in inches?",
    10.0: "was the size given in cm?",
    0.001: "was the size given in micrometres?",
}
"""Likely mistake for each ratio of the measured to the stated length."""


class MeanEdge(NamedTuple):
    """The mean edge of a target in one pair of images."""

    pair: str
    """Name of the left image."""
    target: PlanarTarget
    mean_m: float
    """Mean edge; nan if none was measured."""
    sigma_m: float
    """Standard deviation of that mean from the noise of pixels and joints."""

    @property
    def differs_from_stated(self) -> bool:
        """True if it differs from the stated edge beyond noise and small calibration errors."""
        if not self.target.size_known:
            return False
        stated = stated_edge_m(self.target)
        return abs(self.mean_m - stated) > max(
            _SIGNIFICANT_SIGMAS * self.sigma_m, _MIN_RELATIVE_DIFFERENCE * stated
        )


def mean_edge_sigma(
    head: HeadModel,
    q: FloatArray,
    target: PlanarTarget,
    pixels: FloatArray,
    points: FloatArray,
    pixel_noise_covariances: FloatArray,
) -> float:
    """Sigma of a board's mean edge, m; pixel errors are independent, joint errors common."""
    first, second = neighbour_pairs(target).T
    apart = points[first] - points[second]
    there = np.isfinite(apart).all(axis=1)
    if not there.any():
        return np.nan
    first, second, apart = first[there], second[there], apart[there]
    lengths = np.linalg.norm(apart, axis=1)
    along = apart / lengths[:, None] / len(lengths)
    slopes = np.zeros_like(points)  # derivatives of the mean with respect to each corner
    np.add.at(slopes, first, along)
    np.subtract.at(slopes, second, along)
    used = slopes.any(axis=1)
    variance = float(
        np.einsum("ni,nij,nj->", slopes[used], pixel_noise_covariances[used], slopes[used])
    )
    sure = Noise()
    for turn in np.diag(np.asarray(Noise.of(head).joint_rad))[EYES]:
        if turn.any():
            turned = triangulate_views(
                head, q + head.actuation.joint_velocities_of(turn), pixels, sure
            ).point
            moved = np.linalg.norm(turned[first] - turned[second], axis=1)
            variance += float(moved.mean() - lengths.mean()) ** 2
    return float(np.sqrt(max(variance, 0.0)))


def describe_wrong_edges(name: str, mean_edges: Sequence[MeanEdge]) -> str:
    """Message about targets whose edges differ from the stated size; empty if none do."""
    mean_edges = [each for each in mean_edges if np.isfinite(each.mean_m)]
    off = [each for each in mean_edges if each.differs_from_stated]
    if not off:
        return ""
    lengths, stated = [MM * each.mean_m for each in off], MM * stated_edge_m(off[0].target)
    low, high = f"{min(lengths):.2f}", f"{max(lengths):.2f}"
    found = low if low == high else f"{low} to {high}"
    sigma = MM * float(np.median([each.sigma_m for each in off]))
    ratio = float(np.median(lengths)) / stated
    hint = next(
        (
            f"; {why}"
            for k, why in _UNIT_MISTAKE_HINTS.items()
            if abs(ratio / k - 1.0) < _UNIT_RATIO_TOLERANCE
        ),
        "",
    )
    where = join_first_names(dict.fromkeys(each.pair for each in off))
    if len(mean_edges) > 1:
        where = f"{len(off)} of {len(mean_edges)} places ({where})"
    return (
        f"{name}: edges are {found} mm in {where}, expected {stated:g} ± {sigma:.2g} mm: joint "
        f"angles, the head's calibration or the size do not fit{hint}"
    )
