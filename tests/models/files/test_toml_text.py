"""Plain values as TOML that people read, or in errors, which are no errors of their own."""

import tomllib
from functools import reduce

from vergence.errors import HeadFileError
from vergence.models.toml_table import toml_text


def test_a_short_list_is_on_one_line_and_everything_is_read_back():
    document = {
        "axis": [0.0, -1.5e-9, float("inf")],
        "rotation": [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
        "many": [0.123456789012345 + i for i in range(9)], "words": ["a, b", "[\n 1,\n]", "c"],
        "text": "[\n    1,\n    2,\n]", "empty": [],
        "tables": [{"values": [1, 2]}, {"values": [True]}],
    }  # fmt: skip
    text = toml_text(document)
    assert tomllib.loads(text) == document
    lines = text.splitlines()
    assert "axis = [0.0, -1.5e-09, inf]" in lines
    assert "    [1.0, 0.0, 0.0]," in lines
    assert "values = [1, 2]" in lines
    assert max(map(len, lines)) <= 100


def test_values_nested_too_deep_to_be_written_out_are_called_so():
    deep = reduce(lambda inner, _: {"a": inner}, range(5000), {})
    error = HeadFileError("timing", deep, "a number")
    assert str(error) == "timing: expected a number, got values nested too deep"
