"""Between which values margins are looked for, from which one on, and what people call them.

Onset and phase are no faults; a controller that minds them reads what it cannot know.
"""

from typing import Final, NamedTuple

import numpy as np

from vergence.envs.plants.imperfections import IMPERFECTIONS, PARTS
from vergence.eval.trials.scenarios import Scenario
from vergence.models.head import HeadModel


class Searched(NamedTuple):
    """Where the margins of one imperfection are looked for, and how they are shown."""

    label: str
    least: float
    most: float
    """In the unit of `IMPERFECTIONS`, as `least`."""
    unit: str
    """The unit in which people see it; empty for a ratio."""
    scale: float
    """What it is multiplied by for that."""


SEARCHED: Final = {
    name: Searched(one.label, *one.searched, *one.shown)
    for part in PARTS
    for name, one in IMPERFECTIONS.items()
    if one.part == part
}
"""By name, in the order of tables and figures: part by part of the loop.

An imperfection of each actuator's own has the same value for all of them."""


class Range(NamedTuple):
    """Where the margins of one imperfection are looked for in one scenario."""

    low: float
    expected: float
    """What a scenario has that does not move it; where that is drawn anew for each trial, what the
    model says, or the end of the drawn range that is nearest to it."""
    high: float


def range_of(name: str, scenario: Scenario, head: HeadModel) -> Range:
    """Where the margins of an imperfection are looked for; the expected value is always within.

    Args:
        name: the imperfection.
        scenario: what draws, or does not.
        head: the model that the controller knows.
    """
    expected = float(np.max(IMPERFECTIONS[name].nominal(head)))
    drawn = None if scenario.variation is None else getattr(scenario.variation, name)
    if drawn is not None:
        expected = min(max(expected, drawn[0]), drawn[1])
    searched = SEARCHED[name]
    return Range(min(searched.least, expected), expected, max(searched.most, expected))


def matters(name: str, scenario: Scenario) -> bool:
    """Whether anything follows from an imperfection: the size of outliers where there are any."""
    chance = IMPERFECTIONS[name].of_chance
    if not chance:
        return True
    variation = scenario.variation
    return variation is not None and variation.greatest(chance, 0.0) > 0.0
