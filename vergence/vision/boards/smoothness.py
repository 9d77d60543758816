"""Fit of a homography and a smooth lens distortion to a board's corners, without outliers."""

from typing import Final, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from vergence.vision.boards.homographies import fit_homography

_MAX_DISTORTION_DEGREE: Final = 8
"""Highest degree of the polynomial that models lens distortion on top of a homography (chosen)."""
_COARSE_DEGREE: Final = 3
"""Highest degree in the first fit, which finds corners mistaken for others (chosen)."""
_CORNERS_PER_COEFFICIENT: Final = 2.0
"""Least number of corners per coefficient of that polynomial (chosen: avoids overfitting)."""
_HOMOGRAPHY_PARAMETERS: Final = 4
"""Parameters of a homography per image coordinate (numerical)."""

# Residual of a corner from the fit above which it is an outlier; it exceeds both (chosen).
_STRAY_PX: Final = 0.2
_STRAY_SIGMAS: Final = 6.0  # standard deviations

_MOST_ROUNDS: Final = 8
"""Most rounds of removing outliers (numerical)."""


class SmoothHomographyFit(NamedTuple):
    """Homography of a board plus a smooth lens distortion, fitted to its corners."""

    homography: NDArray[np.float64]
    """Homography from the board's plane to the image."""
    inliers: NDArray[np.bool_]
    """(n,) mask of the inliers."""
    residual_sigma_px: float
    """Standard deviation of the inliers' residuals, of each coordinate; 0 if unknown."""
    origin_distortion_px: NDArray[np.float64]
    """(2,) lens distortion at the board's origin, added to the homography."""
    origin_distortion_sigma_px: float
    """Standard deviation of each coordinate of `origin_distortion_px`."""


def fit_smooth_homography(
    board_m: NDArray[np.float64], pixels: NDArray[np.float64], max_residual_px: NDArray[np.float64]
) -> SmoothHomographyFit | None:
    """Fit a homography and a smooth distortion to corners, without outliers.

    Args:
        board_m: (n, 2) corners on the board, m.
        pixels: (n, 2) these corners in the image, or in an undistorted plane, px.
        max_residual_px: (n,) largest residual of each from a coarse fit, px: less than the
            distance to another corner.

    Returns:
        The fit; None if the corners are collinear, or fewer than four are left.
    """
    good = np.ones(len(pixels), bool)
    fit: _Fit | None = None
    for highest, most_px in ((_COARSE_DEGREE, max_residual_px), (_MAX_DISTORTION_DEGREE, None)):
        for _ in range(_MOST_ROUNDS):
            fit = _fit_polynomial(board_m, pixels, good, highest)
            if fit is None:
                return None
            fine = max(_STRAY_PX, _STRAY_SIGMAS * fit.robust_px)
            over = fit.residual_px / (fine if most_px is None else most_px[good])
            if not fit.overdetermined or over.max() <= 1.0:
                break
            # an outlier also pulls its neighbours away, so only the worst are removed per round
            good[np.flatnonzero(good)[over > max(1.0, 0.5 * float(over.max()))]] = False
    assert fit is not None
    return SmoothHomographyFit(
        fit.homography, good, fit.residual_sigma_px, fit.distortion_px, fit.distortion_sigma_px
    )


class _Fit(NamedTuple):
    homography: NDArray[np.float64]
    residual_px: NDArray[np.float64]
    """(n,) residual of each corner from its prediction by the others."""
    robust_px: float
    """Standard deviation of the residuals, estimated by their median."""
    residual_sigma_px: float
    distortion_px: NDArray[np.float64]
    distortion_sigma_px: float
    overdetermined: bool
    """True if there are more corners than coefficients, so that residuals carry evidence."""


def _fit_polynomial(
    board_m: NDArray[np.float64],
    pixels: NDArray[np.float64],
    good: NDArray[np.bool_],
    highest: int,
) -> _Fit | None:
    """Fit the polynomial with least generalised cross validation (Golub, Heath and Wahba 1979)."""
    count = int(good.sum())
    transform = (
        fit_homography(board_m[good], pixels[good]) if count >= _HOMOGRAPHY_PARAMETERS else None
    )
    if transform is None:
        return None
    residuals = (pixels - cv2.perspectiveTransform(board_m[None], transform)[0])[good]
    terms, ends = _terms(board_m[good] / np.abs(board_m).max(), highest)
    basis = np.linalg.qr(terms)[0]
    shares = basis.T @ residuals
    spent = np.array([0, *ends]) + _HOMOGRAPHY_PARAMETERS
    explained = np.concatenate([[0.0], np.cumsum((shares**2).sum(axis=1))[ends - 1]])
    unexplained = np.maximum((residuals**2).sum() - explained, 0.0)
    free = np.maximum(count - spent, 1e-9)
    best = int(np.argmin(unexplained / free**2))
    used = int(spent[best]) - _HOMOGRAPHY_PARAMETERS
    overdetermined = bool(free[best] >= 1)
    sigma = float(np.sqrt(unexplained[best] / (2.0 * free[best]))) if overdetermined else 0.0
    # all terms but the constant vanish at the origin
    weights = np.linalg.pinv(terms[:, :used])[0] if used else np.zeros(count)
    remaining = residuals - basis[:, :used] @ shares[:used]
    own = 1.0 - (basis[:, :used] ** 2).sum(axis=1) - _HOMOGRAPHY_PARAMETERS / count
    return _Fit(
        transform,
        np.abs(remaining / np.maximum(own, 0.1)[:, None]).max(axis=1),
        1.48 * float(np.median(np.abs(remaining))),
        sigma,
        weights @ residuals,
        sigma * float(np.linalg.norm(weights)),
        overdetermined,
    )


def _terms(
    places: NDArray[np.float64], highest: int
) -> tuple[NDArray[np.float64], NDArray[np.intp]]:
    """Monomials at positions in -1..1, (n, p), lower degrees first; cumulative count by degree."""
    x, y = places.T
    columns, rows = (len(np.unique(np.rint(1e6 * each))) for each in (x, y))
    terms: list[NDArray[np.float64]] = []
    ends: list[int] = []
    for degree in range(highest + 1):
        more = [x**i * y ** (degree - i) for i in range(degree + 1)
                if i < columns and degree - i < rows]  # fmt: skip
        if degree > 0 and _CORNERS_PER_COEFFICIENT * (
            len(terms) + len(more)
        ) + _HOMOGRAPHY_PARAMETERS > len(x):
            break
        terms += more
        ends.append(len(terms))
    return np.stack(terms, axis=1), np.array(ends)
