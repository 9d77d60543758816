"""Fixtures of the evaluation's tests."""

from collections.abc import Callable

import pytest

from tests.conftest import sketched
from tests.eval.trials.toys import STEP, ideal_head
from vergence.eval.article import reproduce
from vergence.eval.comparison.evaluate import EvaluateConfig, Evaluation, evaluate
from vergence.eval.comparison.folder import write_evaluation
from vergence.eval.trials.scenarios import SCENARIOS, Scenario
from vergence.models import HeadModel
from vergence.models.head_file import load_head, save_head

SOURCES = reproduce._sources_digest()


def toy_alone(patch: pytest.MonkeyPatch) -> None:
    """Leave the toy experiment alone in the registry of experiments."""
    patch.setattr(reproduce, "_sources_digest", lambda: SOURCES)  # which takes as long as all else
    for module in ("experiment", "reproduce"):
        patch.setattr(
            f"vergence.eval.article.{module}.EXPERIMENTS",
            {"toy": "tests.eval.article.toy:EXPERIMENT"},
        )


@pytest.fixture
def toy(monkeypatch):
    toy_alone(monkeypatch)


@pytest.fixture
def known(monkeypatch, tmp_path) -> Callable[..., None]:
    """Registers a scenario "known" on a head without lag, where toys settle at known times."""
    save_head(ideal_head(), tmp_path / "ideal.toml")

    def register(**fields: object) -> None:
        options: dict = {"target": STEP.target, "duration_s": 0.5} | fields
        scenario = Scenario(
            name="known", description="a step", head=str(tmp_path / "ideal.toml"), **options
        )
        monkeypatch.setitem(SCENARIOS, "known", scenario)

    register()
    return register


@pytest.fixture(scope="session")
def nominal() -> HeadModel:
    return load_head("physical")


@pytest.fixture(scope="session")
def few() -> Evaluation:
    """An evaluation of the article's law and the baseline; no test changes it."""
    return evaluate(EvaluateConfig(controllers=("ibvs", "ibvs-tuned"), episodes=12))


@pytest.fixture(scope="session")
def few_folder(few, tmp_path_factory):
    """The run folder of that evaluation; no test changes it."""
    place = tmp_path_factory.mktemp("evaluation") / "first run"
    place.mkdir()
    with sketched():
        write_evaluation(place, few)
    return place


def row_of(evaluation: Evaluation, controller: str) -> dict:
    (row,) = (row for row in evaluation.rows() if row["controller"] == controller)
    return row
