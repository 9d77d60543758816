"""The numbers of README and docs are those of the tables that they come from."""

from collections.abc import Callable
from pathlib import Path

import pandas as pd
import pytest

from tests.docs_numbers import disagreements, stated_numbers

ROOT = Path(__file__).resolve().parents[1]


def numbers_of(name: str, columns: list[str]) -> dict[str, float]:
    """Every number of a table in docs/results, by what these columns and its own one say."""
    table = pd.read_csv(ROOT / "docs" / "results" / name).set_index(columns)
    numbers = table.select_dtypes("number").stack()
    return {"/".join(map(str, key)): float(value) for key, value in numbers.items()}


@pytest.fixture(scope="module")
def results() -> dict[str, float]:
    """Those of the evaluation by `scenario/plant/controller/statistic`."""
    return numbers_of("evaluate.csv", ["scenario", "plant", "controller"])


@pytest.fixture(scope="module")
def tables(results) -> dict[str, Callable[[str], float]]:
    """What gives the number of a key, by table."""
    learned = numbers_of("stable_baselines.csv", ["way", "seed"])
    heads = numbers_of("heads.csv", ["head", "scenario", "plant", "controller"])
    return {
        "evaluate": results.__getitem__,
        "heads": lambda key: heads[key.strip("/")],
        "returns": numbers_of("returns.csv", ["scenario", "policy"]).__getitem__,
        "stable_baselines": lambda key: learned[key.strip("/")],
    }


@pytest.mark.parametrize(
    ("name", "number"),
    [
        ("README.md", 95),
        ("docs/evaluate.md", 28),
        ("docs/environment.md", 20),
        ("docs/stable-baselines3.md", 27),
    ],
)
def test_numbers_of_evaluations_are_their_tables(name, number, tables):
    document = (ROOT / name).read_text(encoding="utf-8")
    assert len([one for one in stated_numbers(document) if one.table in tables]) >= number
    assert disagreements(document, tables) == []


def test_every_controller_settles_in_every_trial_of_the_readmes_table(results):
    for scenario in ("workspace", "robust"):
        shares = [
            share
            for key, share in results.items()
            if key.startswith(f"{scenario}/kinematic/") and key.endswith("/settled_fraction")
        ]
        assert shares == [1.0] * 12
