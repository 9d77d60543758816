"""Fixtures shared by the tests of training."""

import dataclasses

import pytest

from tests.training.runs import STEPS, Silent, run_small, small
from vergence.eval.trials.run import run_trials
from vergence.training import run, validation


@pytest.fixture(scope="session", autouse=True)
def undrawn():
    """No run draws its curve, which takes as long as all else of a small one; see `runs.drawn`."""

    def touch(folder, *_arguments):
        for ending in ("png", "svg"):
            (folder / f"curve.{ending}").touch()

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(run, "draw_curve", touch)
        yield


@pytest.fixture(scope="session", autouse=True)
def brief():
    """Validation trials end after a second, where a run's are three times as long."""

    def shorter(controller, scenario, **words):
        scenario = dataclasses.replace(scenario, duration_s=min(scenario.duration_s, 1.0))
        return run_trials(controller, scenario, **words)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(validation, "run_trials", shorter)
        yield


@pytest.fixture(scope="session")
def whole(tmp_path_factory):
    """The result of a run that nothing has happened to; no test changes its folder."""
    return run_small(tmp_path_factory.mktemp("runs") / "whole")


@pytest.fixture(scope="session")
def begun(tmp_path_factory):
    """The folder of the same run, stopped after a quarter of its steps; no test changes it."""
    folder = tmp_path_factory.mktemp("runs") / "begun"
    stopped = run.train(folder, *small(), Silent(stop_after=2))
    assert (stopped.finished, stopped.steps) == (False, STEPS // 4)
    return folder
