"""The live view takes what a log holds, and neither a writer's end nor a new log ends it."""

import numpy as np
import pytest

pytest.importorskip("mcap")
viser = pytest.importorskip("viser")

from tests.recording.logged import log_trials  # noqa: E402
from tests.viewer.served import served  # noqa: E402, F401
from vergence.viewer.live import LiveView  # noqa: E402


def run(live, rounds):
    left = iter(range(rounds))
    live.run(until=lambda: next(left, None) is None)


def test_it_waits_for_a_log_shows_it_and_goes_on_to_a_newer_one(served, tmp_path):  # noqa: F811
    live = LiveView(served, tmp_path)
    run(live, 2)
    assert live.shown == 0
    log_trials(tmp_path / "first.mcap", fault=True)
    live._searched_s = -np.inf
    run(live, 3)
    assert live.shown >= 1
    assert "fault: bus: gone" in live._words.content
    assert "the log is closed" in live._words.content
