"""The search for the last value at which something still holds."""

import itertools

import pytest

from vergence.eval.margins.search import BISECTIONS, GRID_FRACTIONS, last_holding_value


def steps_of(limit: float, begin: float, end: float) -> tuple[float, list[float]]:
    asked = []

    def holds(value: float) -> bool:
        asked.append(value)
        return abs(value - begin) <= abs(limit - begin)

    found = last_holding_value(holds, begin, end)
    assert found is not None
    return found, asked


def test_the_limit_is_found_from_the_good_side():
    sides = ((0.0, 0.1), (1.0, 0.1), (66.7, 300.0), (0.0, -5.0))
    for (begin, end), share in itertools.product(sides, (0.004, 0.02, 0.3, 0.999)):
        limit = begin + share * (end - begin)
        found, asked = steps_of(limit, begin, end)
        assert found in asked
        last = max((0.0, *(one for one in GRID_FRACTIONS if one <= share)))
        following = min(one for one in GRID_FRACTIONS if one > share)
        fineness = abs(end - begin) * (following - last) / 2**BISECTIONS
        # six digits of the values' own
        assert 0.0 <= abs(limit - begin) - abs(found - begin) <= fineness + 1e-4 * abs(end - begin)


def test_where_all_of_it_is_good_the_end_itself_is_found():
    asked = [0.1, *(0.1 + 0.2 * share for share in GRID_FRACTIONS)]
    assert steps_of(1.0, 0.1, 0.3) == (0.3, pytest.approx(asked))


def test_a_gap_ends_the_range_whatever_is_beyond_it():
    found = last_holding_value(lambda value: not 0.2 < value < 0.3, 0.0, 1.0)
    assert found == pytest.approx(0.2, abs=0.01)


def test_nothing_is_found_where_not_even_the_beginning_is_good():
    assert last_holding_value(lambda value: value > 0.5, 0.0, 1.0) is None


def test_a_side_without_room_is_its_only_value():
    asked = []
    assert last_holding_value(lambda value: asked.append(value) or True, 0.0, 0.0) == 0.0
    assert asked == [0.0]
