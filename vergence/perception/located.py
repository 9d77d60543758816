"""Triangulate a target that both eyes see: its corners, its centre, and their covariances."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vergence.models.head import HeadModel
from vergence.models.parts import FloatArray
from vergence.operands import null_nonfinite_elements, null_nonfinite_rows
from vergence.perception.board_centre import centre_weights, weighted_sum
from vergence.perception.edges import MeanEdge, mean_edge_sigma
from vergence.perception.spacing import MM, EdgeSpacing, measure_spacing
from vergence.perception.target_finder import tag_number
from vergence.triangulation import Fix, Noise, triangulate_views
from vergence.vision import Detection
from vergence.vision.targets import AprilTag, Checkerboard, PlanarTarget


class TargetCentre(NamedTuple):
    """The centre of a target in frame N."""

    point: FloatArray
    """(3,) metres; nan without a solution."""
    covariance: FloatArray
    """(3, 3) m^2."""

    @property
    def sigma(self) -> FloatArray:
        """(3,) standard deviations, metres."""
        return np.sqrt(np.diagonal(self.covariance))


@dataclass(frozen=True, kw_only=True, eq=False)
class LocatedTarget:
    """A triangulated target."""

    pair: str
    """Name of the left image."""
    target: PlanarTarget
    pixels: FloatArray
    """(2, n, 2) its corners by eye, px; nan for corners that were not found."""
    sigma_px: FloatArray
    """(2, n, 2) their standard deviations."""
    fix: Fix
    """Triangulation of its n corners."""
    centre: TargetCentre
    edge_sigma_m: float
    """Standard deviation of the mean distance between neighbouring corners, see `mean_edge`."""
    focal_px: float
    """Mean focal length of the head's cameras, which converts a point's gap to pixels."""

    @cached_property
    def valid(self) -> NDArray[np.bool_]:
        """(n,) True for corners with a solution."""
        return np.asarray(self.fix.valid, bool)

    @property
    def spacing(self) -> EdgeSpacing:
        """Distances between its neighbouring corners."""
        return measure_spacing(self.target, [self.fix.point])

    @property
    def mean_edge(self) -> MeanEdge:
        """Mean distance between its neighbouring corners, with its standard deviation."""
        return MeanEdge(self.pair, self.target, self.spacing.mean_m, self.edge_sigma_m)

    @property
    def gap_m(self) -> float:
        """Root mean square of the corners' gaps, metres; nan without a solution."""
        gaps = self.fix.gap[self.valid]
        return float(np.sqrt(np.mean(gaps**2))) if len(gaps) else np.nan

    @property
    def gap_px(self) -> float:
        """Root mean square distance between the lines of sight, as a distance in the image, px."""
        depth = np.linalg.norm(self.fix.point[self.valid], axis=-1)
        gaps = self.focal_px * self.fix.gap[self.valid] / depth
        return float(np.sqrt(np.mean(gaps**2))) if len(gaps) else np.nan

    def document(self) -> dict[str, Any]:
        """Plain values, millimetres and pixels; None for values without a solution."""
        return {
            "pair": self.pair,
            "target": str(self.target),
            "id": tag_number(self.target),
            "pixels": null_nonfinite_rows(self.pixels),
            "points_mm": null_nonfinite_rows(MM * self.fix.point),
            "sigma_mm": null_nonfinite_rows(MM * self.fix.sigma),
            "centre_mm": null_nonfinite_rows(MM * self.centre.point),
            "centre_sigma_mm": null_nonfinite_rows(MM * self.centre.sigma),
            "sigma_px": null_nonfinite_rows(self.sigma_px),
            "gap_mm": null_nonfinite_elements(MM * self.fix.gap),
            "spacing_mm": {
                **self.spacing.document(),
                "sigma": null_nonfinite_elements([MM * self.edge_sigma_m])[0],
            },
        }


def locate_target(
    head: HeadModel, q: FloatArray, pair: str, left: Detection, right: Detection
) -> LocatedTarget:
    """Triangulate a target that both eyes see, at (7,) angles, rad."""
    target = left.target
    own = Noise.of(head)
    turned = [_turned(right, order) for order in equivalent_corner_orders(target)]
    fixes = [_corner_fix(head, q, left, each, own) for each in turned]
    best = int(np.argmin([_mismatch(fix) for fix in fixes])) if len(fixes) > 1 else 0
    right, fix = turned[best], fixes[best]
    sure = [d._replace(corners_sigma_px=np.zeros_like(d.corners_px)) for d in (left, right)]
    of_joints = _corner_fix(head, q, sure[0], sure[1], own).covariance
    centre = (
        _measured_point(head, q, left, right, own)
        if isinstance(target, AprilTag)
        else _board_centre(target, fix, of_joints)
    )
    corners = np.stack([left.corners_px, right.corners_px], axis=1)
    return LocatedTarget(
        pair=pair,
        target=target,
        pixels=np.stack([left.corners_px, right.corners_px]),
        sigma_px=np.stack([left.corners_sigma_px, right.corners_sigma_px]),
        fix=fix,
        centre=centre,
        edge_sigma_m=mean_edge_sigma(
            head, q, target, corners, fix.point, fix.covariance - of_joints
        ),
        focal_px=float(head.cameras.focal.mean()),
    )


def equivalent_corner_orders(target: PlanarTarget) -> list[NDArray[np.intp]]:
    """Possible orders of a board's corners, if turning the board does not change its appearance."""
    places: NDArray[np.intp] = np.arange(len(target.corners_m))
    if not isinstance(target, Checkerboard) or not target.symmetric:
        return [places]
    grid = places.reshape(target.rows, target.columns)
    # a quarter turn keeps the colours only if each side has an odd number of squares
    quarters = target.rows == target.columns and target.rows % 2 == 0
    return [np.rot90(grid, turns).ravel() for turns in (range(4) if quarters else (0, 2))]


def _turned(found: Detection, order: NDArray[np.intp]) -> Detection:
    return found._replace(
        corners_px=found.corners_px[order], corners_sigma_px=found.corners_sigma_px[order]
    )


def _mismatch(fix: Fix) -> float:
    """Cost of matching two views of a board: rms gap, plus a penalty for corners not solved."""
    valid = np.asarray(fix.valid, bool)
    if not valid.any():
        return np.inf
    return float(np.sqrt(np.mean(fix.gap[valid] ** 2)) + 1e3 * (~valid).mean())


def _corner_fix(
    head: HeadModel, q: FloatArray, left: Detection, right: Detection, own: Noise
) -> Fix:
    pixels = np.stack([left.corners_px, right.corners_px], axis=1)
    sigma = np.stack([left.corners_sigma_px, right.corners_sigma_px], axis=1)
    return _fix(head, q, pixels, sigma, own)


def _fix(head: HeadModel, q: FloatArray, pixels: FloatArray, sigma: FloatArray, own: Noise) -> Fix:
    """Triangulate with the detector's pixel noise, or the head file's if the detector has none."""
    known = np.where(np.isfinite(sigma), sigma, head.sensor.detection_noise_px)
    return triangulate_views(head, q, pixels, Noise(pixel_px=known, joint_rad=own.joint_rad))


def _measured_point(
    head: HeadModel, q: FloatArray, left: Detection, right: Detection, own: Noise
) -> TargetCentre:
    pixels = np.stack([left.point_px, right.point_px])
    fix = _fix(head, q, pixels, np.stack([left.sigma_px, right.sigma_px]), own)
    return TargetCentre(fix.point, fix.covariance)


_NAN_CENTRE: Final = TargetCentre(np.full(3, np.nan), np.full((3, 3), np.nan))
"""Centre of a board that cannot be located (numerical)."""


def _board_centre(target: PlanarTarget, fix: Fix, of_joints: FloatArray) -> TargetCentre:
    """Centre of a board: pixel errors average out over its corners, joint errors do not."""
    weights = centre_weights(target.corners_m, np.asarray(fix.valid, bool))
    if not np.isfinite(weights).all():
        return _NAN_CENTRE
    of_pixels = fix.covariance - of_joints
    used = weights != 0.0
    return TargetCentre(
        weighted_sum(fix.point, weights),
        weighted_sum(of_pixels, weights**2) + of_joints[used].mean(axis=0),
    )
