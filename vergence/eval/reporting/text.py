"""Text that a person wrote, with numbers filled in: templates, and how numbers are written."""

import math
from collections.abc import Mapping
from importlib import resources
from typing import Any, Final, NamedTuple

import jinja2

Numbers = Mapping[str, float]
"""The numbers that a text fills in, by name, its unit last; nan for one that does not exist."""

NONE: Final = "–"
"""Stands where there is no number."""


_CAPTION: Final = "caption_"


class SectionText(NamedTuple):
    """The text of a report's section; an empty line ends a paragraph."""

    what: str
    """What was done, and how."""
    found: str
    """What came out."""
    headline: str
    """One sentence of it for the top of the report; empty for none."""
    captions: dict[str, str]
    """What each figure shows and what to conclude, by the figure's name."""


def read_template(package: str, name: str = "section.jinja") -> str:
    """A template that lies in a package.

    Args:
        package: such as `vergence.eval.article.gain_sweep`.
        name: of the file.
    """
    return (resources.files(package) / name).read_text(encoding="utf-8")


def render_text(template: str, **values: Any) -> SectionText:
    """Fill numbers into the text of a section.

    Args:
        template: in the language of Jinja, with the blocks `what` and `found`; it may have
            `headline`, and `caption_` with the name of a figure in which `_` stands for `-`. It
            chooses no words: its sentences are true whatever the numbers are.
        values: what it fills in, by name.

    Returns:
        The blocks, a line a paragraph.

    Raises:
        jinja2.UndefinedError: the text names a number that is not there.
    """
    found = environment().from_string(template)
    context = found.new_context(values)
    text = {name: _unwrapped("".join(block(context))) for name, block in found.blocks.items()}
    captions = {
        name.removeprefix(_CAPTION).replace("_", "-"): words
        for name, words in text.items()
        if name.startswith(_CAPTION)
    }
    return SectionText(text["what"], text["found"], text.get("headline", ""), captions)


def environment(**options: Any) -> jinja2.Environment:
    """Where templates are read: every name has to be there, and numbers have their filters.

    Args:
        options: of `jinja2.Environment`, beyond these.
    """
    made = jinja2.Environment(undefined=jinja2.StrictUndefined, **options)
    made.filters |= {
        "number": format_number,
        "span": format_range,
        "fixed": format_fixed,
        "given": format_given,
    }
    return made


def _unwrapped(text: str) -> str:
    return "\n\n".join(" ".join(lines.split()) for lines in text.strip().split("\n\n"))


def format_number(value: float | None) -> str:
    """Three significant digits, never with an exponent; a dash for none."""
    if value is None or not math.isfinite(value):
        return NONE
    if value == 0.0:
        return "0"
    decimals = max(0, 2 - math.floor(math.log10(abs(value))))
    return f"{float(f'{value:.3g}'):.{decimals}f}"


def format_fixed(value: float | None, decimals: int = 0, signed: bool = False) -> str:
    """So many digits after the point; a dash for none.

    Args:
        value: the number.
        decimals: digits after the point.
        signed: whether a plus stands before what is greater than zero. What rounds to zero never
            has a sign.
    """
    if value is None or not math.isfinite(value):
        return NONE
    text = f"{value:z.{decimals}f}"
    return f"+{text}" if signed and float(text) > 0.0 else text


def format_given(value: float) -> str:
    """A number that somebody gave, with the digits that it was given."""
    return f"{value:zg}"


def format_range(low: float | None, high: float | None) -> str:
    """A range, a single number, or a dash where there is none."""
    ends = dict.fromkeys(map(format_number, (low, high)))
    return " to ".join(end for end in ends if end != NONE) or NONE
