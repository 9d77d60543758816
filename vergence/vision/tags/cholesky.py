"""Solve small linear systems in kernels, in place, by Cholesky factors."""

from math import sqrt

from vergence.kernels import subroutine
from vergence.models.parts import FloatArray


@subroutine
def cholesky_factorise(matrix: FloatArray, size: int) -> bool:
    """Replace a matrix by its lower Cholesky factor; False if it is not positive definite."""
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
def forward_substitute(factor: FloatArray, right_side: FloatArray, size: int) -> None:
    """Solve a lower triangular system, in place."""
    for i in range(size):
        for k in range(i):
            right_side[i] -= factor[i, k] * right_side[k]
        right_side[i] /= factor[i, i]


@subroutine
def cholesky_solve(factor: FloatArray, right_side: FloatArray, size: int) -> None:
    """Solve a system given the lower Cholesky factor of its matrix, in place."""
    forward_substitute(factor, right_side, size)
    for i in range(size - 1, -1, -1):
        for k in range(i + 1, size):
            right_side[i] -= factor[k, i] * right_side[k]
        right_side[i] /= factor[i, i]
