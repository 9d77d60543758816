"""Names of lines stand next to them, in their colours, where nothing else is."""

import numpy as np
import pytest
from matplotlib.text import Text

from vergence.reporting.style import label_lines, new_figure


def panel_of(*lines):
    figure = new_figure(6.0, 4.0)
    panel = figure.subplots()
    for number, line in enumerate(lines):
        panel.plot(np.linspace(0.0, 1.0, len(line)), line, label=f"line {number}")
    panel.set_ylim(0.0, 10.0)
    figure.draw_without_rendering()
    return panel


def names_of(panel):
    return [text for text in panel.texts if text.get_text()]


def test_each_name_has_the_colour_of_its_line_and_stands_nearest_to_it():
    panel = panel_of([2.0, 2.0], [5.0, 5.0], [8.0, 8.0])
    assert label_lines(panel)
    for text, line in zip(names_of(panel), panel.get_lines(), strict=True):
        assert text.get_color() == line.get_color()
        box = Text.get_window_extent(text)
        middle = panel.transData.inverted().transform((box.x0, 0.5 * (box.y0 + box.y1)))[1]
        assert middle == pytest.approx(line.get_ydata()[0], abs=0.8)


def test_names_cover_neither_each_other_nor_a_line():
    rng = np.random.default_rng(0)
    panel = panel_of(*(5.0 + np.cumsum(rng.normal(0.0, 0.4, 30)) for _ in range(4)))
    assert label_lines(panel)
    boxes = [Text.get_window_extent(text) for text in names_of(panel)]
    paths = [panel.transData.transform(line.get_xydata()) for line in panel.get_lines()]
    for number, box in enumerate(boxes):
        assert not any(box.overlaps(other) for other in boxes[:number])
        assert not any(box.contains(*point) for path in paths for point in path)


def test_lines_that_coincide_have_no_legible_names():
    panel = panel_of(*([5.0, 5.0] for _ in range(8)))
    assert not label_lines(panel)
    assert not panel.texts


def test_the_panel_with_the_most_room_has_the_names():
    figure = new_figure(9.0, 4.0)
    crowded, roomy = figure.subplots(1, 2)
    for number in range(5):
        crowded.plot([0.0, 1.0], [5.0, 5.0], label=f"line {number}")
        roomy.plot([0.0, 1.0], [number, number], label=f"line {number}")
    figure.draw_without_rendering()
    assert label_lines(crowded, roomy)
    assert not crowded.texts
    assert len(names_of(roomy)) == 5


def test_a_line_without_values_leaves_the_naming_to_a_legend():
    assert not label_lines(panel_of([2.0, 2.0], [np.nan, np.nan]))
