"""Ranges and starting values of the search for margins, and labels and units of imperfections.

Onset and frame phase are not faults: a controller that is sensitive to them relies on knowledge
that it cannot have.
"""

from typing import Final, NamedTuple

import numpy as np

from vergence.envs.plants.imperfections import IMPERFECTIONS, LOOP_PARTS
from vergence.eval.trials.scenarios import Scenario
from vergence.models.head import HeadModel


class ImperfectionRange(NamedTuple):
    """Search range of one imperfection's margins, and how they are shown."""

    label: str
    lowest: float
    highest: float
    """Ends of the range, `lowest` and `highest`, in the unit of `IMPERFECTIONS`."""
    unit: str
    """Unit in tables and figures; empty for a ratio."""
    scale: float
    """Factor from the unit of `IMPERFECTIONS` to that unit."""


IMPERFECTION_RANGES: Final = {
    name: ImperfectionRange(one.label, *one.search_range, *one.display_unit)
    for part in LOOP_PARTS
    for name, one in IMPERFECTIONS.items()
    if one.part == part
}
"""Search ranges by name, in the order of tables and figures: part by part of the loop.

An imperfection that each actuator has of its own gets the same value for all of them."""


class SearchInterval(NamedTuple):
    """Search range of one imperfection's margins in one scenario, with the expected value."""

    low: float
    expected: float
    """Start of the search: the model's value; if the scenario draws the imperfection, the value of
    the drawn range that is nearest to the model's."""
    high: float


def search_interval(imperfection: str, scenario: Scenario, head: HeadModel) -> SearchInterval:
    """Search range of an imperfection's margins, widened to hold the expected value.

    Args:
        imperfection: the imperfection.
        scenario: the scenario, which may draw the imperfection.
        head: the model that the controller knows.
    """
    expected = float(np.max(IMPERFECTIONS[imperfection].nominal(head)))
    drawn = None if scenario.variation is None else getattr(scenario.variation, imperfection)
    if drawn is not None:
        expected = min(max(expected, drawn[0]), drawn[1])
    searched = IMPERFECTION_RANGES[imperfection]
    return SearchInterval(min(searched.lowest, expected), expected, max(searched.highest, expected))


def has_effect(imperfection: str, scenario: Scenario) -> bool:
    """True if an imperfection has an effect in a scenario.

    The size or duration of random events, such as outliers, has one only if the scenario has such
    events.
    """
    chance = IMPERFECTIONS[imperfection].probability
    if not chance:
        return True
    variation = scenario.variation
    return variation is not None and variation.largest_value(chance, 0.0) > 0.0
