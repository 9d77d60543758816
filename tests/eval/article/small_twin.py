"""Experiments on the physical twin, small enough for tests."""

from functools import cache
from typing import Any, Final
from unittest.mock import patch

from vergence.eval.article.experiment import load_experiment, resolve_config
from vergence.eval.article.reported import static_points
from vergence.reporting.jobs import SerialMapper

_HEADS: Final = {"heads": 4, "scale": 0.4, "noise_poses": 1, "noise_frames": 3}
_SMALL: Final[dict[str, dict[str, Any]]] = {
    "physical-static": {
        "imaged_every": 21, "samples": 4, "offsets_px": [0.0, 200.0], "settle_s": 0.5,
    },
    "physical-moving": {"speed_m_s": 1.0, "settle_s": 0.5, "table_every": 4},
    "fixed-pair": {"samples": 4, "settle_s": 0.5},
}  # fmt: skip
_TINY: Final[dict[str, dict[str, Any]]] = {
    "physical-static": {"samples": 2},
    "physical-moving": {"speed_m_s": 2.0},
    "fixed-pair": {"samples": 2},
}
NAMES: Final = sorted(_SMALL)


def small(name: str, **changes: Any) -> Any:
    """The configuration of an experiment with four heads, a known scale and few images."""
    return resolve_config(load_experiment(name), _HEADS | _SMALL[name] | changes, quick=True)


@cache
def table_of(name):
    """The table of a small run; whoever changes it copies it first."""
    return _run(name, small(name), 0, SerialMapper())


def tiny_table(name, seed, mapper):
    """The table of a run that is too short for anything but a comparison of tables."""
    config = small(name, heads=2, noise_frames=2, settle_s=0.1, **_TINY[name])
    return _run(name, config, seed, mapper)


def _run(name, config, seed, mapper):
    """Run an experiment with five of the 21 points, whose detections take most of its time."""
    few = static_points("physical")[::5]
    with patch("vergence.eval.article.twin.static_points", lambda _: few):
        return load_experiment(name).run(config, seed, mapper)


def scaled(table, column, factor, rows):
    changed = table.copy()
    changed.loc[rows, column] *= factor
    return changed


def verdict_of(rows, quantity, method):
    (row,) = (row for row in rows if (row.quantity, row.method) == (quantity, method))
    return row.verdict
