"""A log is played, stopped and scrubbed."""

from types import SimpleNamespace

import pytest

pytest.importorskip("mcap")
pytest.importorskip("viser")

from tests.recording.logged import STEPS, log_trials
from vergence.viewer.playback import Playback
from vergence.viewer.recorded import load_recorded


@pytest.fixture
def playback(served, tmp_path):
    log_trials(tmp_path / "run.mcap")
    return Playback(served, load_recorded(tmp_path / "run.mcap"))


def shown(playback):
    """Time and words after a moment."""
    left = iter([False])
    playback.run(until=lambda: next(left, True))
    index = playback._recorded.index_at(playback._time_s)
    return index, playback._words(index)[1]


@pytest.mark.slow
def test_buttons_step_to_moments_and_gazes_within_the_log(playback):
    assert playback.playing
    second, last = STEPS + 1, 2 * STEPS + 1
    for button, index, words in (
        ("gaze on", second, "gaze 2 of 2"), ("gaze on", second, "gaze 2 of 2"),
        ("back", second - 1, "gaze 1 of 2"), ("on", second, "gaze 2 of 2"),
        ("gaze back", 0, "gaze 1 of 2"), ("back", 0, "gaze 1 of 2"),
    ):  # fmt: skip
        playback._asked.put(lambda button=button: playback._step(button))
        found, said = shown(playback)
        assert found == index
        assert words in said
        assert not playback.playing
        assert playback._slider.value == pytest.approx(playback._recorded.times_s[index])
    playback._stop_at(playback._end_s)
    playback._step("on")
    assert shown(playback)[0] == last


def test_playing_goes_on_in_real_time_and_begins_again_at_the_end(playback, monkeypatch):
    clock = [0.0]

    def sleep(_s):
        clock[0] += 0.1

    fake = SimpleNamespace(monotonic=lambda: clock[0], sleep=sleep)
    monkeypatch.setattr("vergence.viewer.playback.time", fake)
    playback._speed.value = "0.5"
    times = []

    def until():
        times.append(playback._time_s)
        if len(times) == 4:
            clock[0] += 99.0
        return len(times) == 5

    playback.run(until)
    assert times == pytest.approx([0.0, 0.0, 0.05, 0.1, 0.0])
