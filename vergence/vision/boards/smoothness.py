"""How far corners of a board lie beside what a homography and a smooth lens make of it."""

from typing import Final, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from vergence.vision.boards.homographies import homography

_HIGHEST: Final = 8
"""Degree of the polynomial that stands for what a homography does not explain: a lens."""
_FREE: Final = 2.0
"""Corners by coefficient of that polynomial, at least."""
_OF_HOMOGRAPHY: Final = 4
"""Coefficients for each coordinate of a corner."""
_STRAY_PX: Final = 0.4
_STRAY_SIGMAS: Final = 6.0
"""A corner that lies beside the others' say by more than both is none of the board."""
_MOST_ROUNDS: Final = 8


class Smooth(NamedTuple):
    """A homography, and how corners lie beside it."""

    homography: NDArray[np.float64]
    """From the board's plane to the image."""
    good: NDArray[np.bool_]
    """(n,) which corners lie where the others say."""
    uneven_px: float
    """Standard deviation of each coordinate of those, beside the smooth board; 0 if unknown."""
    bend_px: NDArray[np.float64]
    """(2,) what the lens adds to the homography at the board's origin."""


def smooth_of(board_m: NDArray[np.float64], pixels: NDArray[np.float64]) -> Smooth | None:
    """The smooth board that fits corners, without those that stray.

    The degree of the polynomial is the one with the least generalised cross validation (Golub,
    Heath and Wahba 1979).

    Args:
        board_m: (n, 2) corners on the board.
        pixels: (n, 2) the same in the image, or in a plane without a lens.

    Returns:
        The fit; None where the corners lie on a line, or fewer than four are left.
    """
    scale = 1.0 / np.abs(board_m).max()
    good = np.ones(len(pixels), bool)
    for _ in range(_MOST_ROUNDS):
        count = int(good.sum())
        transform = homography(board_m[good], pixels[good]) if count >= _OF_HOMOGRAPHY else None
        if transform is None:
            return None
        left = pixels - cv2.perspectiveTransform(board_m[None], transform)[0]
        terms, ends = _terms(scale * board_m, count)
        basis = np.linalg.qr(terms[good])[0]
        shares = basis.T @ left[good]
        spent = np.array([0, *ends]) + _OF_HOMOGRAPHY
        explained = np.concatenate([[0.0], np.cumsum((shares**2).sum(axis=1))[ends - 1]])
        unexplained = np.maximum((left[good] ** 2).sum() - explained, 0.0)
        free = np.maximum(count - spent, 1e-9)
        best = int(np.argmin(unexplained / free**2))
        used = int(spent[best]) - _OF_HOMOGRAPHY
        sigma = float(np.sqrt(unexplained[best] / (2.0 * free[best]))) if free[best] >= 1 else 0.0
        beside = left[good] - basis[:, :used] @ shares[:used]
        own = 1.0 - (basis[:, :used] ** 2).sum(axis=1) - _OF_HOMOGRAPHY / count
        away = np.abs(beside / np.maximum(own, 0.1)[:, None]).max(axis=1)
        robust = 1.48 * float(np.median(np.abs(beside)))
        limit = max(_STRAY_PX, _STRAY_SIGMAS * robust)
        if free[best] < 1 or away.max() <= limit:
            break
        # a stray corner drags its neighbours along, which come back without it
        good[np.flatnonzero(good)[away > max(limit, 0.5 * float(away.max()))]] = False
    bend = np.zeros(2)
    if used:  # all terms but the constant vanish at the origin
        bend = np.linalg.lstsq(terms[good, :used], left[good], rcond=None)[0][0]
    return Smooth(transform, good, sigma, bend)


def _terms(
    places: NDArray[np.float64], count: int
) -> tuple[NDArray[np.float64], NDArray[np.intp]]:
    """Polynomials over places within 1, (n, p), the lower degrees first; ends of the degrees."""
    x, y = places.T
    columns, rows = (len(np.unique(np.rint(1e6 * each))) for each in (x, y))
    terms: list[NDArray[np.float64]] = []
    ends: list[int] = []
    for degree in range(_HIGHEST + 1):
        more = [x**i * y ** (degree - i) for i in range(degree + 1)
                if i < columns and degree - i < rows]  # fmt: skip
        if _FREE * (len(terms) + len(more)) + _OF_HOMOGRAPHY > count and degree > 0:
            break
        terms += more
        ends.append(len(terms))
    return np.stack(terms, axis=1), np.array(ends)
