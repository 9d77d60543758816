"""The live view takes what a log holds, and neither a writer's end nor a new log ends it."""

import numpy as np
import pytest

pytest.importorskip("mcap")
pytest.importorskip("viser")

from tests.recording.logged import log_trials
from vergence.viewer.live import LiveView


def run(live, *stages):
    """Run a live view, and each stage after three rounds of the one before."""
    left = iter([lambda: None, *stages, lambda: None])
    rounds = iter(range(3 * (len(stages) + 1)))

    def until():
        number = next(rounds, None)
        if number is not None and number % 3 == 0:
            next(left)()
            live._searched_s = -np.inf
        return number is None

    live.run(until)


@pytest.mark.slow
def test_it_waits_for_a_log_shows_it_and_goes_on_to_a_newer_one(served, tmp_path):
    live, said = LiveView(served, tmp_path), []
    run(
        live,
        lambda: said.append(live.words),
        lambda: log_trials(tmp_path / "first.mcap", fault=True),
        lambda: said.append(live.words),
        lambda: log_trials(tmp_path / "second.mcap"),
        lambda: said.append(live.words),
    )
    waiting, first, second = said
    assert "waiting for a log" in waiting
    for text in ("first.mcap", "gaze 2", "fault: bus: gone", "the log is closed"):
        assert text in first
    assert "second.mcap" in second
    assert "bus: gone" not in second
    assert live.shown >= 1


@pytest.mark.slow
def test_neither_another_file_nor_an_older_log_takes_its_place(served, tmp_path):
    live, said = LiveView(served, tmp_path), []
    log_trials(tmp_path / "older.mcap")
    log_trials(tmp_path / "robot.mcap")
    run(
        live,
        lambda: (tmp_path / "garbage.mcap").write_bytes(b"no log" * 100),
        lambda: said.append(live.words),
        lambda: [(tmp_path / name).unlink() for name in ("garbage.mcap", "robot.mcap")],
        lambda: said.append(live.words),
    )
    assert all("robot.mcap" in words for words in said)
