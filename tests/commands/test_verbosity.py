"""Log output of -v and -vv at any position, and none without them."""

import logging
import re

import pytest

from tests.commands.called import call
from vergence.commands.gaze import Gaze
from vergence.hardware.robot import warn


@pytest.fixture(autouse=True)
def _talks(monkeypatch):
    """A gaze that does nothing but talk."""

    def run(_gaze):
        log = logging.getLogger("vergence.hardware.robot")
        log.info("trial %d begins", 3)
        log.debug("a detail")
        log.error("stopped: a reason")
        return 0

    monkeypatch.setattr(Gaze, "run", run)


def test_v_says_what_happens_with_the_time_and_the_place(capsys):
    for words in (["-v", "gaze"], ["gaze", "--seed", "3", "--verbose"]):
        assert call(*words) == 0
        info, error = capsys.readouterr().err.splitlines()
        assert re.fullmatch(r"vergence: \d+\.\d{3} s hardware\.robot: trial 3 begins", info)
        assert error.endswith(" s hardware.robot: error: stopped: a reason")


def test_vv_says_details_too_and_without_it_nothing_is_said(capsys):
    for words in (["-vv", "gaze"], ["-v", "gaze", "-v"]):
        assert call(*words) == 0
        assert "hardware.robot: a detail" in capsys.readouterr().err
    assert call("gaze") == 0
    assert capsys.readouterr().err == ""


@pytest.mark.filterwarnings("always::vergence.VergenceWarning")
def test_a_robots_warning_is_shown_once(capsys, monkeypatch):
    monkeypatch.setattr(Gaze, "run", lambda _gaze: warn("a servo is warm") or 0)
    assert call("gaze", "-v") == 0
    assert capsys.readouterr().err == "vergence: warning: a servo is warm\n"
