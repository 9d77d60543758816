"""Marks name where a number of a document comes from, and a wrong number is found."""

import pytest

from tests.docs_numbers import disagreements, stated_numbers

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


def test_numbers_are_named_one_by_one():
    text = "It takes 183 ms, not 0.2 s.\n\n<!-- numbers t: 183 = a/b*1000; 0.2 = a/b -->"
    assert [stated.key for stated in stated_numbers(text)] == ["a/b", "a/b"]
    assert disagreements(text, TABLES) == []


def test_cells_are_named_by_row_and_column():
    assert [stated.text for stated in stated_numbers(TABLE)] == ["1,007", "3.0", "2,500"]
    assert disagreements(TABLE, TABLES) == []


@pytest.mark.parametrize(
    ("right", "wrong", "said"),
    [("1,007", "1,008", "1,008, but x/one/s is 1007.4"), ("3.0", "3.1", "3.1, but x/one/r is 3")],
)
def test_a_wrong_number_is_found(right, wrong, said):
    assert disagreements(TABLE.replace(right, wrong), TABLES) == [said]


def test_a_mark_of_what_is_not_there_is_an_error():
    with pytest.raises(AssertionError, match="184 is not in the text"):
        list(stated_numbers("It takes 183 ms.\n\n<!-- numbers t: 184 = a/b -->"))


def test_a_line_without_a_name_is_an_error():
    with pytest.raises(AssertionError, match="2 lines of a table, but 1 rows"):
        list(stated_numbers(TABLE.replace("one; two\n-->", "one\n-->")))


def test_a_key_that_the_table_does_not_have_is_an_error():
    with pytest.raises(KeyError):
        disagreements("1\n\n<!-- numbers t: 1 = no/such -->", TABLES)
