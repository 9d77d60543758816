"""Without OpenGL everything works, and a command states why it is switched off."""

import os

import pytest

from vergence.cli import main
from vergence.viewer import opengl


@pytest.mark.slow
def test_a_choice_with_which_mujoco_cannot_be_imported_is_switched_off(monkeypatch):
    monkeypatch.setenv("MUJOCO_GL", "nonsense")
    failure = opengl.disable_broken_opengl()
    assert failure is not None
    assert failure.startswith("MUJOCO_GL=nonsense: ")
    assert "nonsense" in failure.removeprefix("MUJOCO_GL=nonsense: ")
    assert os.environ["MUJOCO_GL"] == "disable"  # also for workers


def test_a_choice_that_cannot_fail_is_not_tried(monkeypatch):
    monkeypatch.setattr(opengl, "_failure", None)
    for value in ("", "glfw", "disable", "off"):
        monkeypatch.setenv("MUJOCO_GL", value)
        assert opengl.disable_broken_opengl() is None
        assert os.environ["MUJOCO_GL"] == value


def test_the_reason_is_the_exception_and_not_what_follows_it():
    reason = opengl._failure("import atexit; atexit.register(lambda: 1 / 0); [].missing")
    assert reason == "AttributeError: 'list' object has no attribute 'missing'"
    assert opengl._failure("import os; os.abort()") == "ended with code -6"
    assert opengl._failure("pass") is None


@pytest.mark.slow
def test_a_command_says_why_opengl_is_switched_off_and_ends_well(monkeypatch, capsys):
    monkeypatch.setenv("MUJOCO_GL", "osmesa")
    monkeypatch.setattr(opengl, "_failure", lambda _code: "AttributeError: no OSMesa")
    with pytest.raises(SystemExit) as stopped:
        main(["info"])
    assert stopped.value.code == 0
    assert capsys.readouterr().err == (
        "vergence: going on without OpenGL, as it does not work with MUJOCO_GL=osmesa: "
        "AttributeError: no OSMesa\n"
    )
