"""Numbers as a person reads them, and templates that numbers are filled in."""

import jinja2
import pytest

from vergence.reporting.text import (
    format_fixed,
    format_input_value,
    format_number,
    format_range,
    render_text,
)


def test_numbers_have_three_significant_digits_and_no_exponent():
    for value, text in [
        (0.0, "0"), (0.00912, "0.00912"), (1.0, "1.00"), (-2.5, "-2.50"), (124.49, "124"),
        (3780.0, "3780"), (float("nan"), "–"), (None, "–"),
    ]:  # fmt: skip
        assert format_number(value) == text


def test_a_range_of_one_number_is_that_number():
    assert format_range(2.0, 2.0) == format_range(2.0, None) == "2.00"
    assert format_range(1.0, 2.0) == "1.00 to 2.00"
    assert format_range(None, None) == "–"
    assert format_range(1.0001, 1.0002) == "1.00"


def test_decimals_can_be_fixed():
    assert format_fixed(2.0, 2) == "2.00"
    assert format_fixed(1150.0) == "1150"
    assert format_fixed(float("nan"), 2) == "–"
    assert [format_fixed(v, 1, signed=True) for v in (1.0, -1.0)] == ["+1.0", "-1.0"]


def test_what_rounds_to_zero_has_no_sign():
    for value in (-0.0, -1e-9, -0.0004, 0.0004):
        assert format_fixed(value, 3) == "0.000"
        assert format_fixed(value, 3, signed=True) == "0.000"
    assert format_input_value(-0.0) == format_number(-0.0) == "0"


def test_a_template_may_have_a_headline_and_captions():
    more = "{% block headline %}So.{% endblock %}"
    more += "{% block caption_a_b %}It {{ low_mm | fixed }}.{% endblock %}"
    text = render_text(TEMPLATE + more, config={"gain": 4.0}, low_mm=1.0, high_mm=2.0)
    assert (text.headline, text.captions) == ("So.", {"a-b": "It 1."})
    assert render_text(TEMPLATE, config={"gain": 4.0}, low_mm=1.0, high_mm=2.0).captions == {}


def test_a_given_number_keeps_its_digits():
    given = {0.3: "0.3", 4.0: "4", 650.0: "650", 0.057: "0.057"}
    assert {value: format_input_value(value) for value in given} == given


TEMPLATE = """
{% block what %}One line
and another.

A second paragraph: {{ config.gain | number }}.{% endblock %}
{% block found %}
  From {{ low_mm | span(high_mm) }} mm.
{% endblock %}
"""


def test_a_template_becomes_two_texts_of_a_line_a_paragraph():
    text = render_text(TEMPLATE, config={"gain": 4.0}, low_mm=0.001, high_mm=25.4)
    assert text.what == "One line and another.\n\nA second paragraph: 4.00."
    assert text.found == "From 0.00100 to 25.4 mm."


def test_a_number_that_is_not_there_is_an_error():
    with pytest.raises(jinja2.UndefinedError, match="high_mm"):
        render_text(TEMPLATE, config={"gain": 4.0}, low_mm=0.001)
