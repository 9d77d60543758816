"""Records: one class says where the numbers of a row, or the arrays of a group, lie."""

from typing import Annotated, NamedTuple

import numpy as np
import pytest

from vergence.kernels import (
    compiled,
    make_row,
    make_table,
    record_view,
    row_layout,
    row_size,
    unpack_table,
)
from vergence.models.parts import FloatArray


class Eye:
    gain: float
    turn: Annotated[FloatArray, 2, 2]


class Head:
    lag_s: float
    eyes: Annotated[list[Eye], 2]
    left: Eye


HEAD = row_layout(Head)


def test_fields_lie_in_the_order_of_their_annotations() -> None:
    row = np.arange(16.0)
    head = row.view(HEAD)[0]
    assert row_size(HEAD) == 16
    assert head.lag_s == 0.0
    assert head.eyes[1]["gain"] == 6.0
    assert head.left.turn.tolist() == [[12.0, 13.0], [14.0, 15.0]]


def test_a_row_is_made_from_the_values_of_its_fields() -> None:
    row = make_row(HEAD, lag_s=0.03, left=(2.0, np.eye(2)))
    assert row.tolist() == [0.03, *[0.0] * 10, 2.0, 1.0, 0.0, 0.0, 1.0]


def test_a_field_that_does_not_exist_is_an_error() -> None:
    with pytest.raises(ValueError, match="no field of name gian"):
        make_row(row_layout(Eye), gian=1.0)


def test_what_is_written_by_name_is_written_to_the_row() -> None:
    row = np.zeros(16)
    head = record_view.py_func(row, HEAD)
    head.lag_s = 3.0
    head.left.turn[1, 0] = 5.0
    assert row[0] == 3.0
    assert row[14] == 5.0


class Inner(NamedTuple):
    values: FloatArray
    number: int
    nothing: None


class Group(NamedTuple):
    total: FloatArray
    inner: Inner


@compiled
def _add(table: np.ndarray) -> int:
    own: Group = unpack_table(table)
    own.total[0] += own.inner.values[1]
    return own.inner.number if own.inner.nothing is None else 0


def test_a_table_gives_a_group_back_with_its_names() -> None:
    group = Group(np.zeros(2), Inner(np.arange(3.0), 5, None))
    assert _add(make_table(group)) == 5
    assert group.total.tolist() == [1.0, 0.0]
