"""Errors show whatever value is wrong, and are no errors of their own."""

from functools import reduce

from vergence.errors import HeadFileError


def test_values_nested_too_deep_to_be_written_out_are_called_so():
    deep = reduce(lambda inner, _: {"a": inner}, range(5000), {})
    error = HeadFileError("timing", deep, "a number")
    assert str(error) == "timing: expected a number, got values nested too deep"
