"""How far corners of a board lie beside what a homography and a smooth lens make of it."""

from typing import Final, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from vergence.vision.boards.homographies import homography

_HIGHEST: Final = 8
"""Degree of the polynomial that stands for what a homography does not explain: a lens."""
_COARSE: Final = 3
"""The same, for finding corners that were taken for others."""
_FREE: Final = 2.0
"""Corners by coefficient of that polynomial, at least."""
_OF_HOMOGRAPHY: Final = 4
"""Coefficients for each coordinate of a corner."""
_STRAY_PX: Final = 0.2
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
    bend_sigma_px: float
    """Standard deviation of each."""


def smooth_of(
    board_m: NDArray[np.float64], pixels: NDArray[np.float64], room_px: NDArray[np.float64]
) -> Smooth | None:
    """The smooth board that fits corners, without those that stray.

    Args:
        board_m: (n, 2) corners on the board.
        pixels: (n, 2) the same in the image, or in a plane without a lens.
        room_px: (n,) how far each may lie beside a coarse fit: less than another corner is away.

    Returns:
        The fit; None where the corners lie on a line, or fewer than four are left.
    """
    good = np.ones(len(pixels), bool)
    fit: _Fit | None = None
    for highest, room in ((_COARSE, room_px), (_HIGHEST, None)):
        for _ in range(_MOST_ROUNDS):
            fit = _fitted(board_m, pixels, good, highest)
            if fit is None:
                return None
            fine = max(_STRAY_PX, _STRAY_SIGMAS * fit.robust_px)
            over = fit.beside_px / (fine if room is None else room[good])
            if not fit.tells or over.max() <= 1.0:
                break
            # a stray corner drags its neighbours along, which come back without it
            good[np.flatnonzero(good)[over > max(1.0, 0.5 * float(over.max()))]] = False
    assert fit is not None
    return Smooth(fit.homography, good, fit.uneven_px, fit.bend_px, fit.bend_sigma_px)


class _Fit(NamedTuple):
    homography: NDArray[np.float64]
    beside_px: NDArray[np.float64]
    """(n,) how far each lies from where the others say."""
    robust_px: float
    """A standard deviation of what is left, by the median."""
    uneven_px: float
    bend_px: NDArray[np.float64]
    bend_sigma_px: float
    tells: bool
    """Whether there are more corners than coefficients."""


def _fitted(
    board_m: NDArray[np.float64],
    pixels: NDArray[np.float64],
    good: NDArray[np.bool_],
    highest: int,
) -> _Fit | None:
    """The polynomial with the least generalised cross validation (Golub, Heath and Wahba 1979)."""
    count = int(good.sum())
    transform = homography(board_m[good], pixels[good]) if count >= _OF_HOMOGRAPHY else None
    if transform is None:
        return None
    left = (pixels - cv2.perspectiveTransform(board_m[None], transform)[0])[good]
    terms, ends = _terms(board_m[good] / np.abs(board_m).max(), highest)
    basis = np.linalg.qr(terms)[0]
    shares = basis.T @ left
    spent = np.array([0, *ends]) + _OF_HOMOGRAPHY
    explained = np.concatenate([[0.0], np.cumsum((shares**2).sum(axis=1))[ends - 1]])
    unexplained = np.maximum((left**2).sum() - explained, 0.0)
    free = np.maximum(count - spent, 1e-9)
    best = int(np.argmin(unexplained / free**2))
    used = int(spent[best]) - _OF_HOMOGRAPHY
    tells = bool(free[best] >= 1)
    sigma = float(np.sqrt(unexplained[best] / (2.0 * free[best]))) if tells else 0.0
    # all terms but the constant vanish at the origin
    weights = np.linalg.pinv(terms[:, :used])[0] if used else np.zeros(count)
    beside = left - basis[:, :used] @ shares[:used]
    own = 1.0 - (basis[:, :used] ** 2).sum(axis=1) - _OF_HOMOGRAPHY / count
    return _Fit(
        transform,
        np.abs(beside / np.maximum(own, 0.1)[:, None]).max(axis=1),
        1.48 * float(np.median(np.abs(beside))),
        sigma,
        weights @ left,
        sigma * float(np.linalg.norm(weights)),
        tells,
    )


def _terms(
    places: NDArray[np.float64], highest: int
) -> tuple[NDArray[np.float64], NDArray[np.intp]]:
    """Polynomials over places within 1, (n, p), the lower degrees first; ends of the degrees."""
    x, y = places.T
    columns, rows = (len(np.unique(np.rint(1e6 * each))) for each in (x, y))
    terms: list[NDArray[np.float64]] = []
    ends: list[int] = []
    for degree in range(highest + 1):
        more = [x**i * y ** (degree - i) for i in range(degree + 1)
                if i < columns and degree - i < rows]  # fmt: skip
        if degree > 0 and _FREE * (len(terms) + len(more)) + _OF_HOMOGRAPHY > len(x):
            break
        terms += more
        ends.append(len(terms))
    return np.stack(terms, axis=1), np.array(ends)
