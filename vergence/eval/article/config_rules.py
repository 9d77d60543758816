"""Rules for the values of an experiment's config, by the names of its fields."""

import shlex
from collections.abc import Mapping
from typing import Any, Final

from vergence.errors import ConfigurationError
from vergence.models.head_file import load_head

_SIGNED: Final = ("point_mm", "origin_mm", "end_mm", "place_mm", "aside_deg")
"""Name endings of coordinates and angles, which may be negative."""
_NOT_SIGNED: Final = ("mount_place_mm",)
_MAY_BE_ZERO: Final = ("settle_s", "worse_margin", "mount_rotation_deg", "mount_place_mm")
"""Fields that may be zero, besides those whose default has a zero; all others must be positive."""
_MOST_COUNT: Final = 10_000_000
"""Largest integer that a field may have (chosen: far above any useful count)."""
_ORDERED: Final = (
    ("least_gain", "greatest_gain"),
    ("least_threshold_px", "greatest_threshold_px"),
)
"""Pairs of fields; the first must not exceed the second."""
_RISING: Final = ("onset_gains",)
"""Fields with two values, the first below the second."""
ARTICLE_HEADS: Final = ("simulated", "physical")
"""Names of the article's own heads; the experiments reproduce their figures."""
_STEPS: Final[tuple[tuple[str, str | None, str], ...]] = (
    ("gain_step", "least_gain", "greatest_gain"),
    ("plane_step", "least_gain", "greatest_gain"),
    ("threshold_step_px", "least_threshold_px", "greatest_threshold_px"),
    ("lag_step_s", None, "greatest_lag_s"),
)
"""For each grid: the fields of its step, its first value (None for zero) and its last value."""
_MOST_STEPS: Final = 100_000
"""Largest number of steps of a grid (chosen: bounds memory, far above any useful grid)."""


def check_value(key: str, name: str, value: Any, default: Any) -> None:
    """Refuse a number or a head that a field of this name must not have.

    Args:
        key: the field's name in error messages.
        name: the field's name.
        value: a new value of the default's type.
        default: the field's default.

    Raises:
        ConfigurationError: the value is not allowed.
    """
    if name == "head":
        _check_head(key, value)
    place = isinstance(default, tuple) and len(default) < 4 and name.endswith(("_mm", "_px"))
    if place and len(value) != len(default):
        raise ConfigurationError(f"{key}: expected {len(default)} numbers, got {value!r}")
    signed = name.endswith(_SIGNED) and name not in _NOT_SIGNED
    defaults = default if isinstance(default, tuple) else (default,)
    zero = name in _MAY_BE_ZERO or 0 in defaults
    for one in value if isinstance(value, tuple) else (value,):
        if isinstance(one, bool | str) or not isinstance(one, int | float) or signed:
            continue
        if one < 0 or (one == 0 and not zero):
            least = "of at least 0" if zero else "above 0"
            raise ConfigurationError(f"{key}: expected a number {least}, got {one!r}")
        if isinstance(one, int) and one > _MOST_COUNT:
            raise ConfigurationError(f"{key}: expected at most {_MOST_COUNT}, got {one!r}")


def _check_head(key: str, name: str) -> None:
    """Refuse a head, given by name or file, that is not one of the article's."""
    head = load_head(name)
    if head.digest not in {load_head(own).digest for own in ARTICLE_HEADS}:
        raise ConfigurationError(
            f"{key}: expected {' or '.join(ARTICLE_HEADS)}, the article's own heads, got {name}; "
            f"vergence evaluate --head {shlex.quote(name)} compares controllers on it"
        )


def check_bounds(config_name: str, values: Mapping[str, Any]) -> None:
    """Refuse reversed bounds, and grids with too many steps.

    Args:
        config_name: the config's name in error messages.
        values: all of its fields.

    Raises:
        ConfigurationError: bounds are reversed, or a grid has too many steps.
    """
    for low, high in _ORDERED:
        if low in values and not values[low] <= values[high]:
            raise ConfigurationError(
                f"{config_name}: expected {low} <= {high}, got {values[low]} and {values[high]}"
            )
    for name in _RISING:
        if name in values and (len(values[name]) != 2 or not values[name][0] < values[name][1]):
            raise ConfigurationError(
                f"{config_name}.{name}: expected two rising numbers, got {values[name]}"
            )
    for step, least, most in _STEPS:
        if step not in values:
            continue
        span = values[most] - (0.0 if least is None else values[least])
        if span > _MOST_STEPS * values[step]:
            raise ConfigurationError(
                f"{config_name}.{step}: expected at most {_MOST_STEPS} steps to {most} = "
                f"{values[most]}, got {values[step]}"
            )
