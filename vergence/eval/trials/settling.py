"""Bands of settling, and the names of their columns in tables."""

from dataclasses import dataclass
from typing import Final

import numpy as np


@dataclass(frozen=True, order=True)
class SettlingBand:
    """A band of settling, on the norm of each eye's error, and the names of its columns.

    Names hold the band's width, as in `settle_2px_s`, `settle_05px_s`, `settle_2_5px_s` and
    `bound_2px_s`. For the band of one pixel, only names of settle times hold it: `settle_1px_s`,
    but `bound_s`.
    """

    px: float

    @property
    def _name(self) -> str:
        whole, _, part = np.format_float_positional(self.px, trim="-").partition(".")
        # 0.5 is written 05; 2.5 needs the separator, or it would read as 25
        return f"{whole}{'_' if part and whole != '0' else ''}{part}px"

    @property
    def _tail(self) -> str:
        return "" if self == ONE_PX else f"_{self._name}"

    @property
    def settle_s_column(self) -> str:
        """A trial's settle time."""
        return f"settle_{self._name}_s"

    @property
    def bound_s_column(self) -> str:
        """A trial's time-optimal bound."""
        return f"bound{self._tail}_s"

    @property
    def ratio_column(self) -> str:
        """A trial's ratio of settle time to bound."""
        return f"ratio_to_bound{self._tail}"

    @property
    def settled_column(self) -> str:
        """True if a trial settled."""
        return f"settled{self._tail}"

    @property
    def settled_fraction_column(self) -> str:
        """The fraction of the trials that settled."""
        return f"{self.settled_column}_fraction"

    @property
    def settle_median_s_column(self) -> str:
        """The median settle time."""
        return f"settle_{self._name}_median_s"

    @property
    def settle_p95_s_column(self) -> str:
        """The 95th percentile of the settle times."""
        return f"settle_{self._name}_p95_s"

    @property
    def ratio_median_column(self) -> str:
        """The median ratio to the bound."""
        return f"{self.ratio_column}_median"

    @property
    def ratio_p95_column(self) -> str:
        """The 95th percentile of the ratios to the bound."""
        return f"{self.ratio_column}_p95"


ONE_PX: Final = SettlingBand(1.0)
"""Band of one pixel (chosen)."""
_STANDARD_BANDS: Final = (ONE_PX, SettlingBand(2.0))
"""Bands of every table (chosen): 2 px leads in scenarios whose backlash and quantisation of
commands and encoders are as large as a pixel."""
HALF_PX: Final = SettlingBand(0.5)
"""Band with settle times in every table, but with a bound only if it leads (chosen)."""


def bands_with_bound(leading_band_px: float) -> list[SettlingBand]:
    """The bands to which a scenario's trials have time-optimal bounds, narrowest first.

    Args:
        leading_band_px: the scenario's leading band, px.
    """
    return sorted({*_STANDARD_BANDS, SettlingBand(leading_band_px)})


def bands_with_settle_time(leading_band_px: float) -> list[SettlingBand]:
    """The bands whose settle times tables hold: those with a bound, and 0.5 px; narrowest first.

    Args:
        leading_band_px: the scenario's leading band, px.
    """
    return sorted({HALF_PX, *bands_with_bound(leading_band_px)})
