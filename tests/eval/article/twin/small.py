"""Experiments on the physical twin, small enough for tests."""

from typing import Any

from vergence.eval.article.experiment import load_experiment, resolve_config


def small(name: str, **changes: Any) -> Any:
    """The configuration of an experiment with four heads, a known scale and few images."""
    heads = {"heads": 4, "scale": 0.4, "noise_poses": 1, "noise_frames": 3}
    return resolve_config(load_experiment(name), heads | changes, quick=True)


def scaled(table, column, factor, rows):
    """A table with some values of a column multiplied."""
    changed = table.copy()
    changed.loc[rows, column] *= factor
    return changed


def verdict_of(rows, quantity, method):
    """The verdict of the one row of a summary with a quantity and method."""
    (row,) = (row for row in rows if (row.quantity, row.method) == (quantity, method))
    return row.verdict
