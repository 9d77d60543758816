"""Gauss-Newton steps of a tag's fit: normal equations without the levels, and their solution."""

from math import sqrt

import numpy as np

from vergence._jit import subroutine
from vergence.models.parts import FloatArray
from vergence.vision.plane import through
from vergence.vision.tags.pixels import UNKNOWNS, Sums


@subroutine
def normal_equations(
    pixels: FloatArray,
    count: int,
    sums: Sums,
    levels: FloatArray,
    blocks: int,
    weights: FloatArray,
    matrix: FloatArray,
    right: FloatArray,
) -> None:
    """The normal equations of a step, levels eliminated."""
    for j in range(UNKNOWNS):
        right[j] = 0.0
        for i in range(UNKNOWNS):
            matrix[j, i] = 0.0
    for n in range(count):
        k = int(pixels[n, 1])
        if k < 0 or levels[k, 1] <= 0.0:
            continue
        contrast = levels[k, 1]
        r = pixels[n, 0] - levels[k, 0] - contrast * pixels[n, 2]
        weight = weights[k] * contrast
        for j in range(UNKNOWNS):
            slope = weight * pixels[n, 3 + j]
            right[j] += slope * r
            slope *= contrast
            # all of the row: loops of one length run several numbers at once
            for i in range(UNKNOWNS):
                matrix[j, i] += slope * pixels[n, 3 + i]
    for k in range(blocks):
        if levels[k, 1] <= 0.0:
            continue
        count_k, t, tt = sums.plain[k, 0], sums.plain[k, 1], sums.plain[k, 2]
        det = count_k * tt - t * t
        weight = weights[k] * levels[k, 1] * levels[k, 1] / det
        for j in range(UNKNOWNS):
            one, by_print = sums.slopes[k, 0, j], sums.slopes[k, 1, j]
            p, q = tt * one - t * by_print, count_k * by_print - t * one
            for i in range(j + 1):
                matrix[j, i] -= weight * (p * sums.slopes[k, 0, i] + q * sums.slopes[k, 1, i])


@subroutine
def factorise(matrix: FloatArray) -> bool:
    """The lower Cholesky factor in place; False where the matrix is not positive definite."""
    size = len(matrix)
    for j in range(size):
        for i in range(j, size):
            total = matrix[i, j]
            for k in range(j):
                total -= matrix[i, k] * matrix[j, k]
            if i == j:
                if not total > 1e-12:
                    return False
                matrix[j, j] = sqrt(total)
            else:
                matrix[i, j] = total / matrix[j, j]
    return True


@subroutine
def solve(factor: FloatArray, right: FloatArray) -> None:
    """Solve with a lower Cholesky factor, in place."""
    size = len(right)
    for i in range(size):
        for k in range(i):
            right[i] -= factor[i, k] * right[k]
        right[i] /= factor[i, i]
    for i in range(size - 1, -1, -1):
        for k in range(i + 1, size):
            right[i] -= factor[k, i] * right[k]
        right[i] /= factor[i, i]


@subroutine
def move_plane(G: FloatArray, step: FloatArray) -> None:
    """Move the plane: G becomes (1 + step) G."""
    for j in range(3):
        a, b, c = G[0, j], G[1, j], G[2, j]
        G[0, j] = (1.0 + step[0]) * a + step[1] * b + step[2] * c
        G[1, j] = step[3] * a + (1.0 + step[4]) * b + step[5] * c
        G[2, j] = step[6] * a + step[7] * b + c


@subroutine
def covariances_of(
    factor: FloatArray, G: FloatArray, H: FloatArray, variance: float, covariances: FloatArray
) -> None:
    """The covariances of corners and centre: J N^-1 J^T times the variance that is left."""
    J, column = np.empty((2, UNKNOWNS)), np.empty(UNKNOWNS)
    for r in range(2):
        for j in range(UNKNOWNS):
            J[r, j] = 0.0
    g, h, i = G[2, 0], G[2, 1], G[2, 2]
    for point in range(5):
        x = -1.0 if point == 0 or point == 3 else 1.0
        y = -1.0 if point < 2 else 1.0
        if point == 4:
            x = y = 0.0
        u, v = through(H, x, y)
        w = g * u + h * v + i
        # the plane's coordinates by pixels
        a, b = (G[0, 0] - x * g) / w, (G[0, 1] - x * h) / w
        c, d = (G[1, 0] - y * g) / w, (G[1, 1] - y * h) / w
        det = a * d - b * c
        for j in range(8):
            by_x = x if j == 0 else y if j == 1 else 1.0 if j == 2 else 0.0
            by_y = x if j == 3 else y if j == 4 else 1.0 if j == 5 else 0.0
            if j == 6:
                by_x, by_y = -x * x, -x * y
            if j == 7:
                by_x, by_y = -x * y, -y * y
            J[0, j] = -(d * by_x - b * by_y) / det
            J[1, j] = -(a * by_y - c * by_x) / det
        for r in range(2):
            for j in range(UNKNOWNS):
                column[j] = J[r, j]
            solve(factor, column)
            for s in range(2):
                total = 0.0
                for j in range(UNKNOWNS):
                    total += J[s, j] * column[j]
                covariances[point, r, s] = variance * total
