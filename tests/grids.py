"""Some cells of a grid of parameters, where all of them would show nothing new."""

import itertools
import random
from collections.abc import Sequence
from typing import Any


def some_of(*axes: Sequence[Any], seed: int = 0) -> list[tuple[Any, ...]]:
    """The cells that find what depends on one value or on two extremes, and one drawn at random.

    Every value of every axis is in one, and any two axes meet in all four pairs of their first and
    last values (an orthogonal array of strength 2); each cell comes once.
    """
    longest = max(map(len, axes))
    values = [tuple(i % len(axis) for axis in axes) for i in range(longest)]
    bits = len(axes).bit_length()
    corners = [
        tuple((len(axis) - 1) * ((row & i).bit_count() % 2) for i, axis in enumerate(axes, 1))
        for row in range(2**bits)
    ]
    cells = dict.fromkeys(corners + values)
    others = [cell for cell in itertools.product(*map(range, map(len, axes))) if cell not in cells]
    drawn = random.Random(seed).sample(others, min(1, len(others)))
    return [tuple(axis[i] for axis, i in zip(axes, cell, strict=True)) for cell in [*cells, *drawn]]
