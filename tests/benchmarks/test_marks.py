"""Marks name where a number of a document comes from, and a wrong number is found."""

import pytest

from benchmarks.marks import disagreements, filled, stated_numbers
from tests.naming import named

TABLES = {"t": {"a/b": 0.18333, "x/one/s": 1.0074, "x/two/s": 2.5, "x/one/r": 3.0}.__getitem__}
TABLE = """\
| who | time | by |
| --- | --- | --- |
| one | 1,007 ms | **3.0** |
| two | 2,500 ms | |

<!-- cells t
columns: x/*/s*1000; x/*/r
rows: one; two
-->
"""


def test_numbers_and_cells_are_named_and_a_wrong_one_is_found():
    text = "It takes 183 ms, not 0.2 s.\n\n<!-- numbers t: 183 = a/b*1000; 0.2 = a/b -->"
    assert [stated.key for stated in stated_numbers(text)] == ["a/b", "a/b"]
    assert [stated.text for stated in stated_numbers(TABLE)] == ["1,007", "3.0", "2,500", ""]
    assert disagreements(text, TABLES) == disagreements(TABLE, TABLES) == []
    assert disagreements(TABLE.replace("1,007", "1,008"), TABLES) == [
        "1,008, but x/one/s is 1007.4"
    ]
    assert disagreements(TABLE.replace("3.0", "3.1"), TABLES) == ["3.1, but x/one/r is 3"]


def test_a_mark_of_what_is_not_there_is_an_error():
    for text, error, said in (
        ("183 ms.\n\n<!-- numbers t: 184 = a/b -->", AssertionError, "184 is not in the text"),
        (TABLE.replace("one; two\n-->", "one\n-->"), AssertionError, "2 lines of a table"),
        ("1\n\n<!-- numbers t: 1 = no/such -->", KeyError, "no/such"),
    ):
        with named(text), pytest.raises(error, match=said):
            disagreements(text, TABLES)


RANGES = """\
| what | one | two |
| --- | --- | --- |
| late, ms | 0 to 300 | - |
| drift | -0.05 to 0.040 | **9 to 8** |

<!-- cells t
columns: w/one/*/low..high; w/two/*/low..high
rows: late_s*1000; drift
-->
"""
ENDS = {
    "w/one/late_s/low": 0.0, "w/one/late_s/high": 0.3,
    "w/one/drift/low": -0.05, "w/one/drift/high": 0.04,
    "w/two/late_s/low": 0.0125, "w/two/late_s/high": 1.23456,
    "w/two/drift/low": 0.0, "w/two/drift/high": 7.6,
}  # fmt: skip


def test_ranges_have_two_numbers_and_rows_a_scale_of_their_own():
    ranges = {"t": ENDS.__getitem__}
    assert disagreements(RANGES, ranges) == [
        "no number, but w/two/late_s/low is 12.5",
        "no number, but w/two/late_s/high is 1234.56",
        "9, but w/two/drift/low is 0",
    ]


def test_cells_are_filled_with_the_digits_they_have_and_what_stands_about_them():
    ranges = {"t": ENDS.__getitem__}
    done = filled(RANGES, ranges)
    assert "| late, ms | 0 to 300 | 12.5 to 1,235 |" in done
    assert "| drift | -0.05 to 0.040 | **0 to 8** |" in done
    assert disagreements(done, ranges) == []
    assert filled(done, ranges) == done
    wrong = TABLE.replace("1,007", "12").replace("3.0", "7.0")
    assert filled(wrong, TABLES) == TABLE
