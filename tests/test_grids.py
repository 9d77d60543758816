"""Some cells of a grid hold each value and each pair of extremes."""

import itertools

import pytest

from tests.grids import some_of


@pytest.mark.parametrize("sizes", [(1,), (4,), (2, 2), (18, 5), (3, 1, 7), (2, 3, 4, 5, 6)])
def test_cells_hold_every_value_and_the_corners_of_any_two_axes(sizes):
    axes = [range(size) for size in sizes]
    cells = some_of(*axes)
    assert len(cells) == len(set(cells))
    assert set(cells) <= set(itertools.product(*axes))
    for place, axis in enumerate(axes):
        assert {cell[place] for cell in cells} == set(axis)
    for (i, one), (j, other) in itertools.combinations(enumerate(axes), 2):
        corners = set(itertools.product((one[0], one[-1]), (other[0], other[-1])))
        assert corners <= {(cell[i], cell[j]) for cell in cells}


def test_one_cell_is_drawn_by_the_seed():
    drawn = {some_of(range(18), range(5), seed=seed)[-1] for seed in range(20)}
    assert len(drawn) > 10
    assert some_of(range(18), range(5)) == some_of(range(18), range(5))
