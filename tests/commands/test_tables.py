"""Tables on terminals of any width."""

import io
import re

from rich.console import Console

from vergence.commands.tables import print_table

COLUMNS = ["", "x (mm)", "y (mm)", "z (mm)", "common perpendicular (mm)"]
ROWS = [
    ["truth", "-1234.567", "-145.000", "12500.000", ""],
    ["gaze, 1 sigma of a fix", "0.123", "+0.456", "-17.891", "0.0001"],
]
NUMBERS = {cell for row in ROWS for cell in row[1:] if cell}


def printed(width: int, columns=COLUMNS, rows=ROWS, **options) -> str:
    out = io.StringIO()
    console = Console(width=width, file=out, highlight=False)
    print_table(columns, rows, console=console, **options)
    return out.getvalue()


def test_every_number_is_printed_whole_at_any_width():
    for width in (20, 40, 80, 200):
        text = printed(width)
        assert set(re.findall(r"[-+]?\d+\.\d+", text)) == NUMBERS, width
        assert "…" not in text
        assert max(map(len, text.splitlines())) <= max(width, 26)


def test_where_there_is_room_a_row_is_a_line_and_elsewhere_each_number_is_named():
    lines = printed(80, title="presets").lstrip().splitlines()
    assert lines[0].startswith("presets")
    assert any(all(number in line for number in ROWS[0][1:4]) for line in lines)
    text = printed(40)
    assert "x (mm): -1234.567" in text
    assert "common perpendicular (mm): 0.0001" in text


def test_text_wraps_between_words_and_is_no_markup():
    rows = [["[bold]a name[/bold] of several words", "0.5 to 1.25 mm"]]
    text = printed(40, ["result", "ours"], rows)
    assert "0.5 to 1.25 mm" in text
    assert "[bold]a" in text
    assert all(len(line) <= 40 for line in text.splitlines())


def test_no_word_of_two_columns_of_text_is_cut():
    rows = [
        ["eyes.left.focal_px, eyes.right.focal_px", "not in the file: a view of 60 degrees"],
        ["actuators.version.acceleration_rad_s2, b", "given in place of 50000 rad/s in the file"],
    ]
    expected = {word for row in rows for cell in row for word in cell.split()}
    for width in (30, 60, 81, 160):
        words = printed(width, ["assumed", "why"], rows, wrapped=(0, 1)).split()
        assert expected - set(words) == set(), width


def test_of_long_names_the_ends_are_enough_where_these_tell_them_apart():
    names = [f"a-recording-of-one-evening-{number:05d}.png" for number in (1, 2)]
    rows = [[name, "12.500"] for name in names]
    text = printed(30, ["image", "u (px)"], rows, shortenable=(0,))
    assert len(text.splitlines()) == 4
    assert "…n-00001.png"[-9:] in text
    assert names[0] in printed(80, ["image", "u (px)"], rows, shortenable=(0,))
    alike = [[f"{name}-of-the-left-eye-of-the-desk", "12.500"] for name in ("a", "b")]
    for row in alike:
        assert row[0] in printed(30, ["image", "u (px)"], alike, shortenable=(0,))
