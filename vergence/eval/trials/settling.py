"""Bands of settling, and the columns of tables that tell of each."""

from dataclasses import dataclass
from typing import Final

import numpy as np


@dataclass(frozen=True, order=True)
class Band:
    """A band of settling, on the norm of each eye's error, and the names of its columns.

    Settle times are named by the band, as `settle_2px_s`, `settle_05px_s` and `settle_2_5px_s`.
    The other columns are so too, as `bound_2px_s`, but for the band of one pixel: `bound_s`.
    """

    px: float

    @property
    def _name(self) -> str:
        whole, _, part = np.format_float_positional(self.px, trim="-").partition(".")
        # without a sign in between, a half would be 05, but 2.5 px and 25 px the same
        return f"{whole}{'_' if part and whole != '0' else ''}{part}px"

    @property
    def _tail(self) -> str:
        return "" if self == ONE_PX else f"_{self._name}"

    @property
    def settle_s(self) -> str:
        """A trial's settle time."""
        return f"settle_{self._name}_s"

    @property
    def bound_s(self) -> str:
        """A trial's time-optimal bound."""
        return f"bound{self._tail}_s"

    @property
    def ratio(self) -> str:
        """A trial's settle time by the bound."""
        return f"ratio_to_bound{self._tail}"

    @property
    def settled(self) -> str:
        """Whether a trial settled."""
        return f"settled{self._tail}"

    @property
    def settled_fraction(self) -> str:
        """The fraction of the trials that settled."""
        return f"{self.settled}_fraction"

    @property
    def settle_median_s(self) -> str:
        """The median settle time."""
        return f"settle_{self._name}_median_s"

    @property
    def settle_p95_s(self) -> str:
        """The 95th percentile of the settle times."""
        return f"settle_{self._name}_p95_s"

    @property
    def ratio_median(self) -> str:
        """The median ratio to the bound."""
        return f"{self.ratio}_median"

    @property
    def ratio_p95(self) -> str:
        """The 95th percentile of the ratios to the bound."""
        return f"{self.ratio}_p95"


ONE_PX: Final = Band(1.0)
_ALWAYS: Final = (ONE_PX, Band(2.0))
"""2 px leads where play, steps of the commands and of the encoders are as large as a pixel."""
HALF_PX: Final = Band(0.5)
"""Settle times to this band are in every table, its bound only where it leads."""


def judged_bands(leading_px: float) -> list[Band]:
    """The bands by which a scenario's trials are judged, each with its bound, narrowest first.

    Args:
        leading_px: the scenario's leading band, px.
    """
    return sorted({*_ALWAYS, Band(leading_px)})


def timed_bands(leading_px: float) -> list[Band]:
    """The bands to which a scenario's trials have settle times, narrowest first.

    Args:
        leading_px: the scenario's leading band, px.
    """
    return sorted({HALF_PX, *judged_bands(leading_px)})
