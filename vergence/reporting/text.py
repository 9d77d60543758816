"""Text of reports: templates, the glossary, and numbers as reports and terminals show them."""

import math
from collections.abc import Mapping
from importlib import resources
from typing import Any, Final, NamedTuple

import jinja2

Numbers = Mapping[str, float]
"""Numbers for a template, by name with the unit last; nan for an undefined number."""

NONE: Final = "–"
"""Placeholder for a missing number."""


_CAPTION_PREFIX: Final = "caption_"


class SectionText(NamedTuple):
    """The text of a report's section; an empty line ends a paragraph."""

    what: str
    """Description of the work and its method."""
    found: str
    """Results."""
    headline: str
    """One sentence for the top of the report; empty for none."""
    captions: dict[str, str]
    """Captions, with the conclusions to draw, by the figures' names."""


def read_template(package: str, name: str = "section.jinja") -> str:
    """Read a template from a package, such as `vergence.eval.comparison`."""
    return (resources.files(package) / name).read_text(encoding="utf-8")


def render_text(template: str, **values: Any) -> SectionText:
    """Fill values into a template of a section's text, and put each paragraph on one line.

    It has the blocks `what` and `found`, perhaps `headline`, and `caption_` followed by the name of
    a figure with `_` in place of `-`. Its sentences must hold for all values of the numbers.
    """
    found = jinja_environment().from_string(template)
    context = found.new_context(values)
    text = {name: _unwrapped("".join(block(context))) for name, block in found.blocks.items()}
    captions = {
        name.removeprefix(_CAPTION_PREFIX).replace("_", "-"): words
        for name, words in text.items()
        if name.startswith(_CAPTION_PREFIX)
    }
    return SectionText(text["what"], text["found"], text.get("headline", ""), captions)


def jinja_environment(**options: Any) -> jinja2.Environment:
    """Make a Jinja environment with filters for numbers; an undefined name is an error."""
    made = jinja2.Environment(undefined=jinja2.StrictUndefined, **options)
    made.filters |= {
        "number": format_number,
        "span": format_range,
        "fixed": format_fixed,
        "given": format_input_value,
    }
    return made


def _unwrapped(text: str) -> str:
    return "\n\n".join(" ".join(lines.split()) for lines in text.strip().split("\n\n"))


def format_number(value: float | None) -> str:
    """Format a number with three significant digits and no exponent; a dash for none."""
    if value is None or not math.isfinite(value):
        return NONE
    if value == 0.0:
        return "0"
    decimals = max(0, 2 - math.floor(math.log10(abs(value))))
    return f"{float(f'{value:.3g}'):.{decimals}f}"


def format_fixed(value: float | None, decimals: int = 0, signed: bool = False) -> str:
    """Format a number with fixed decimals, and a plus if signed and above 0; a dash for none."""
    if value is None or not math.isfinite(value):
        return NONE
    text = f"{value:z.{decimals}f}"
    return f"+{text}" if signed and float(text) > 0.0 else text


def format_input_value(value: float) -> str:
    """Format a configured number, such as an option or a band, with up to six digits."""
    return f"{value:zg}"


def format_range(low: float | None, high: float | None) -> str:
    """Format a range; one number if both ends look alike or one is missing, a dash for none."""
    ends = dict.fromkeys(map(format_number, (low, high)))
    return " to ".join(end for end in ends if end != NONE) or NONE


GLOSSARY: Final[dict[str, str]] = {
    "gaze": "The method of the article: both eyes hold the target at their principal points, and "
    "the point where their optical axes cross follows from the joint angles alone.",
    "ITPC": "The article's comparison method, integrated two-pose calibration: two-view "
    "triangulation from the target's pixels in both images, with the pose between the cameras "
    "computed from the joint angles of the exposure. Its formulas are not public; ours are a "
    "reconstruction.",
    "fix": "One triangulated point: the middle of the shortest segment between the two lines of "
    "sight.",
    "gap": "The length of that segment, the common perpendicular: zero where the lines meet, and "
    "greater with every error that the two eyes do not share.",
    "fixation": "The eyes at rest with the target at the principal point of both.",
    "settle time": "From the moment the target appears or jumps until both eyes' true errors stay "
    "below a threshold to the end of the trial; 1 px where no other is named. A trial whose eyes "
    "swing has none.",
    "swing": "The speed of an eye joint goes on spanning more than 20 degrees/s, through a whole "
    "second, although the target rests.",
    "overshoot": "How far the target's image moves past the principal point, as a part of the "
    "step.",
    "gain, k": "The law's speed: without delay the pixel error decays as exp(-k t).",
    "lag": "The time constant with which a joint's velocity follows its command.",
    "principal point": "Where the optical axis meets the image.",
    "uncertainty": "The standard deviation of a fix that the detections' noise alone would cause.",
    "twin": "A simulated head whose true geometry differs from the model that controls it by drawn "
    "errors; a population of such heads stands for the article's one.",
}
"""Explanations by term, in the order of the report."""

METHODS_LEGEND: Final = (
    "gaze: where the optical axes cross, from the joint angles alone. "
    "ITPC (integrated two-pose calibration): where the rays through the target's pixels cross, "
    "from the joint angles of their exposure."
)
"""Explanation of the two methods, for below a table on a terminal."""
