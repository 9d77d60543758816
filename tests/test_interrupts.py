"""Ctrl-C ends the command line in one line, and is a program's own where it only imports us."""

import os
import signal
import subprocess
import sys
import time
import weakref

import pytest

from tests.naming import named
from vergence import interrupts
from vergence.cli import main


@pytest.fixture
def restored(monkeypatch):
    """Restore the handler of Ctrl-C after the test."""
    monkeypatch.setattr(interrupts, "started_as_command", False)
    before = signal.getsignal(signal.SIGINT)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.usefixtures("restored")
def test_only_the_command_line_is_guarded_and_no_answer_that_somebody_else_has_chosen(monkeypatch):
    for program, words, guarded in (
        ("/usr/bin/vergence", "", True), ("vergence.exe", "", True), ("vergence.py", "", False),
        ("-m", "python -m vergence gaze", True), ("-m", "python -mvergence", True),
        ("-m", "python -m pytest", False),
        ("-m", "python -m mine.train vergence", False), ("/home/me/train.py", "", False),
        ("", "", False),
    ):  # fmt: skip
        with named(program, words):
            signal.signal(signal.SIGINT, signal.default_int_handler)
            monkeypatch.setattr(sys, "argv", [program])
            monkeypatch.setattr(sys, "orig_argv", words.split())
            interrupts.end_quietly_on_interrupt()
            assert (signal.getsignal(signal.SIGINT) is not signal.default_int_handler) == guarded
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    monkeypatch.setattr(sys, "argv", ["/usr/bin/vergence"])
    interrupts.end_quietly_on_interrupt()
    interrupts.raise_on_interrupt()
    interrupts.ignore_interrupts()
    assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN


# `argv` is that of a command line; the signal comes in the first import
FIRST_IMPORT = """
import os, signal, sys
signal.signal(signal.SIGINT, signal.default_int_handler)  # a background job ignores Ctrl-C
sys.argv = ["/usr/bin/vergence"]
class Interrupted:
    def find_spec(self, name, *rest):
        if name == "tyro":
            os.kill(os.getpid(), signal.SIGINT)
sys.meta_path.insert(0, Interrupted())
import vergence.cli
"""
INTERRUPTED = (130, "vergence: interrupted: nothing was written\n")


def test_ctrl_c_while_the_package_is_imported_is_one_line_and_exit_code_130():
    words = [sys.executable, "-c", FIRST_IMPORT]
    done = subprocess.run(words, capture_output=True, text=True)
    assert (done.returncode, done.stderr, done.stdout) == (*INTERRUPTED, "")


@pytest.fixture
def end_of(restored, monkeypatch, capsys):
    """Exit code and last words of the command line, if a function takes the command's place."""

    def end(command) -> tuple[int, str]:
        monkeypatch.setattr(interrupts, "interrupted", False)
        monkeypatch.setattr(sys, "argv", ["/usr/bin/vergence"])
        monkeypatch.setattr(sys, "unraisablehook", sys.unraisablehook)
        monkeypatch.setattr("vergence.cli._run", command)
        interrupts.end_quietly_on_interrupt()
        with pytest.raises(SystemExit) as stopped:
            main(["info"])
        return stopped.value.code, capsys.readouterr().err

    return end


def test_ctrl_c_in_a_callback_that_cannot_raise_ends_the_command(end_of):
    def interrupted_in_finaliser(_words: list[str]) -> None:
        weakref.finalize(set(), os.kill, os.getpid(), signal.SIGINT)
        time.sleep(60.0)
        print("slept", file=sys.stderr)

    assert end_of(interrupted_in_finaliser) == INTERRUPTED


@pytest.mark.usefixtures("restored")
def test_ctrl_c_comes_after_what_it_must_not_disturb():
    done = []
    with pytest.raises(KeyboardInterrupt), interrupts.postponed():  # noqa: PT012
        os.kill(os.getpid(), signal.SIGINT)
        done.append("undisturbed")
    assert done == ["undisturbed"]
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_an_error_that_a_library_makes_of_ctrl_c_is_an_interruption(end_of):
    def interrupted_import(_words: list[str]) -> None:
        try:
            os.kill(os.getpid(), signal.SIGINT)
        except KeyboardInterrupt:
            raise ImportError("numpy failed to import") from None

    assert end_of(interrupted_import) == INTERRUPTED


PESTERED = """
import _thread, threading, time
from tests.vision.poses import pose
from tests.vision.scenes import rig, scene
from vergence.vision import AprilTag, make_detector

camera, rendering = rig("simulated")
image = scene(camera, AprilTag(), pose(0, 0, 1), rendering).image
detector = make_detector(AprilTag(), camera)
tag = detector.detect(image)

def pester():
    for _ in range(500):
        time.sleep(0.003)
        _thread.interrupt_main()
    done.append(True)

done, started, interruptions = [], [], 0
while not done:
    try:
        if not started:
            started.append(threading.Thread(target=pester, daemon=True))
            started[0].start()
        while not done:
            assert detector.track(image, tag) is not None
    except KeyboardInterrupt:
        interruptions += 1
print(interruptions > 9)
"""


@pytest.mark.nightly
def test_ctrl_c_while_a_tag_is_fitted_harms_nothing():
    done = subprocess.run([sys.executable, "-c", PESTERED], capture_output=True, text=True)
    assert (done.returncode, done.stdout.strip()) == (0, "True"), done.stderr
