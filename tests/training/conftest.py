"""Fixtures shared by the tests of training; whoever only collects tests imports no torch here."""

import dataclasses

import pytest


@pytest.fixture(scope="session", autouse=True)
def undrawn():
    """No run draws its curve, which takes as long as all else of a small one; see `runs.drawn`."""

    def touch(folder, *_arguments):
        for ending in ("png", "svg"):
            (folder / f"curve.{ending}").touch()

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("vergence.training.run.draw_curve", touch)
        yield


@pytest.fixture(scope="session", autouse=True)
def brief():
    """Validation trials end after a second, where a run's are three times as long."""
    from vergence.training import validation

    whole = validation.run_trials

    def shorter(controller, scenario, **words):
        scenario = dataclasses.replace(scenario, duration_s=min(scenario.duration_s, 1.0))
        return whole(controller, scenario, **words)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(validation, "run_trials", shorter)
        yield


@pytest.fixture(scope="session")
def whole(tmp_path_factory):
    """The result of a run that nothing has happened to; no test changes its folder."""
    from tests.training.runs import run_small

    return run_small(tmp_path_factory.mktemp("runs") / "whole")


@pytest.fixture(scope="session")
def begun(tmp_path_factory):
    """The folder of the same run, stopped after a quarter of its steps; no test changes it."""
    from tests.training.runs import STEPS, Silent, small
    from vergence.training import run

    folder = tmp_path_factory.mktemp("runs") / "begun"
    stopped = run.train(folder, *small(), Silent(stop_after=2))
    assert (stopped.finished, stopped.steps) == (False, STEPS // 4)
    return folder
