"""The options of Stable-Baselines3's PPO that a run may set, and their bounds."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

from vergence.errors import ConfigurationError, refuse_unknown

MAX_OPTION_VALUE: Final = 1e30
"""Largest value of an option, well within float32 (numerical)."""


@dataclass(frozen=True, kw_only=True)
class OptionRange:
    """Bounds of a numeric option."""

    low: float = 0.0
    high: float = MAX_OPTION_VALUE
    excludes_low: bool = False
    """True if `low` itself is excluded."""
    integer: bool = False
    """True if only integers are allowed."""

    def allows(self, value: object) -> bool:
        """True if a value is within the bounds."""
        if isinstance(value, bool) or not isinstance(value, int if self.integer else int | float):
            return False
        return self.low <= value <= self.high and not (self.excludes_low and value == self.low)

    def __str__(self) -> str:
        kind = "a whole number" if self.integer else "a number"
        first = f"{kind} above {self.low:g}" if self.excludes_low else f"{kind} from {self.low:g}"
        rest = [f"to {self.high:g}"] if self.high < _MAX_COUNT else []
        return " ".join([first, *rest])


_MAX_COUNT: Final = 2**31
"""Largest count, beyond any practical one (numerical)."""
_FRACTION_RANGE: Final = OptionRange(high=1.0)
_COUNT_RANGE: Final = OptionRange(low=1, high=_MAX_COUNT, integer=True)
_POSITIVE_RANGE: Final = OptionRange(excludes_low=True)

_RANGE_BY_OPTION: Final[dict[str, OptionRange | None]] = {
    "learning_rate": _POSITIVE_RANGE,
    "n_steps": _COUNT_RANGE,
    "batch_size": OptionRange(low=2, high=_MAX_COUNT, integer=True),
    "n_epochs": _COUNT_RANGE,
    "gamma": _FRACTION_RANGE,
    "gae_lambda": _FRACTION_RANGE,
    "clip_range": _POSITIVE_RANGE,
    "clip_range_vf": _POSITIVE_RANGE,
    "normalize_advantage": None,
    "ent_coef": OptionRange(),
    "vf_coef": OptionRange(),
    "max_grad_norm": _POSITIVE_RANGE,
    "target_kl": _POSITIVE_RANGE,
}
"""Bounds by option; None for a boolean."""


def check_ppo_options(options: Mapping[str, Any]) -> None:
    """Raise an error for an invalid option of PPO.

    Args:
        options: values by Stable-Baselines3's names.

    Raises:
        ConfigurationError: a name is unknown or a value out of bounds.
    """
    refuse_unknown("algorithm", options, _RANGE_BY_OPTION)
    for name, value in options.items():
        bounds = _RANGE_BY_OPTION[name]
        if bounds is None and not isinstance(value, bool):
            raise ConfigurationError(f"algorithm.{name}: expected true or false, got {value!r}")
        if bounds is not None and not bounds.allows(value):
            raise ConfigurationError(f"algorithm.{name}: expected {bounds}, got {value!r}")
