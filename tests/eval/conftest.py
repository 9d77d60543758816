"""Fixtures of the evaluation's tests."""

import pytest


def toy_alone(patch: pytest.MonkeyPatch) -> None:
    """Leave the toy experiment alone in the registry of experiments."""
    for module in ("experiment", "folder", "overrides", "reproduce"):
        patch.setattr(
            f"vergence.eval.article.{module}.EXPERIMENTS",
            {"toy": "tests.eval.article.toy:EXPERIMENT"},
        )


@pytest.fixture
def toy(monkeypatch):
    """The registry of experiments holds the toy experiment alone."""
    toy_alone(monkeypatch)
