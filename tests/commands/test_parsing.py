"""Words that make a command, and words that make none."""

import re
import subprocess
import sys

import pytest

import vergence
from tests.commands.called import call, refused
from vergence.commands.parsing import parse_command
from vergence.controllers.controller import make_controller
from vergence.envs.plant import make_plant
from vergence.errors import UnknownNameError
from vergence.models import load_head

COMMANDS = [
    *(["gaze"], ["reproduce"], ["train"], ["evaluate"], ["tune"], ["locate"], ["detect"], ["info"]),
    ["print-target"], *(["export", "mjcf"], ["export", "urdf"], ["export", "bundle"]),
    *(["import", "urdf"], ["import", "stereo"]),
]  # fmt: skip


def test_version_is_that_of_the_package(capsys):
    assert call("--version") == 0
    assert capsys.readouterr().out == f"vergence {vergence.__version__}\n"


@pytest.mark.slow
def test_no_words_at_all_are_misuse_and_print_the_help():
    done = subprocess.run([sys.executable, "-m", "vergence"], capture_output=True, text=True)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith("usage: vergence")
    assert "triangulate" in done.stderr


@pytest.mark.slow
def test_what_is_missing_is_named_with_the_help_of_its_own_command(capsys):
    for words, missing, command in [
        (["locate"], ["LEFT", "RIGHT", "--head HEAD"], "locate"),
        (["import", "urdf", "robot.urdf"], ["--base FRAME"], "import urdf"),
    ]:
        line = refused(capsys, *words)
        assert all(one in line for one in missing)
        assert line.endswith(f"(see vergence {command} --help)")


@pytest.mark.slow
def test_a_misspelt_name_is_answered_by_the_one_that_was_meant(capsys):
    for words, meant in [
        (["gaez"], "gaze"), (["gaze", "--pont", "1", "2", "3"], "--point"),
        (["import", "urdf", "robot.urdf", "--actuators", "comon-tilt"], "common-tilt"),
        (["evaluate", "--scenario", "workspce"], "workspace"),
        (["reproduce", "time-respons"], "time-response"),
    ]:  # fmt: skip
        assert f"did you mean {meant}?" in refused(capsys, *words)


def test_so_is_one_that_is_looked_up_from_python_unless_it_is_like_none():
    for look_up, meant in [
        (lambda: load_head("physicl"), "physical"),
        (lambda: make_controller("pursuitt", load_head("physical")), "pursuit"),
        (lambda: make_plant("kinemtic", load_head("physical")), "kinematic"),
    ]:
        with pytest.raises(UnknownNameError, match=rf"did you mean {meant}\?"):
            look_up()
    with pytest.raises(UnknownNameError) as error:
        load_head("xyzzy")
    assert "mean" not in str(error.value)


@pytest.mark.slow
def test_a_value_that_cannot_be_is_answered_by_what_could(capsys):
    for words, expected in [
        (["gaze", "--gain", "much"], "--gain: expected a number, got 'much'"),
        (["evaluate", "--trials=1.5"], "--trials: expected a whole number, got '1.5'"),
        (["gaze", "--point", "0", "a", "1"], "--point: expected numbers X Y Z, got '0' 'a' '1'"),
        (["detect", "--eye", "middle"], "--eye: expected one of left, right, got 'middle'"),
        (["gaze", "--point", "0"], "--point: expected 3 values"),
    ]:
        assert expected in refused(capsys, *words)


@pytest.mark.slow
def test_help_shows_nothing_of_python(capsys):
    for command in COMMANDS:
        assert call(*command, "--help") == 0, command
        text = re.sub(r"[\s│]+", " ", capsys.readouterr().out)
        assert not re.findall(r"None|typing|Tuple|<class|\(default: \)|STR", text), command


@pytest.mark.slow
def test_a_point_may_still_be_given_by_its_former_name(capsys):
    command = parse_command(["gaze", "--target", "0", "-100", "900"])
    assert command.config.target_mm == (0.0, -100.0, 900.0)
    assert "--point" in capsys.readouterr().err


def test_a_target_that_is_none_is_told_what_can_be_looked_at(capsys):
    for words, expected in (
        (["gaze", "--target", "face"], "face:MODEL.onnx"),
        (["gaze", "--target", "red ball"], "colour:#RRGGBB"),
        (["detect", "a.png", "--target", "red ball"], "printed board"),
    ):
        line = refused(capsys, *words)
        assert expected in line
        assert repr(words[-1]) in line
