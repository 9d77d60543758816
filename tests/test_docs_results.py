"""The numbers of README and docs are those of the table that they come from."""

from pathlib import Path

import pandas as pd
import pytest

from tests.docs_numbers import disagreements, stated_numbers

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="module")
def results() -> dict[str, float]:
    """Every number of the evaluation by `scenario/plant/controller/statistic`."""
    table = pd.read_csv(ROOT / "docs" / "results" / "evaluate.csv")
    table = table.set_index(["scenario", "plant", "controller"]).stack()
    return {"/".join(map(str, key)): float(value) for key, value in table.items()}


@pytest.mark.parametrize(("name", "number"), [("README.md", 43), ("docs/learning.md", 14)])
def test_numbers_of_the_evaluation_are_its_tables(name, number, results):
    document = (ROOT / name).read_text(encoding="utf-8")
    stated = [one for one in stated_numbers(document) if one.table == "evaluate"]
    assert len(stated) >= number
    assert disagreements(document, {"evaluate": results.__getitem__}) == []


def test_every_controller_settles_in_every_trial_of_the_readmes_table(results):
    for scenario in ("workspace", "robust"):
        shares = [
            share
            for key, share in results.items()
            if key.startswith(f"{scenario}/kinematic/") and key.endswith("/settled_fraction")
        ]
        assert shares == [1.0] * 11
