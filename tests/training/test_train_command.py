"""The command `vergence train`: killed, interrupted, gone on with, refused."""

import io
import signal
import subprocess
import sys
from pathlib import Path

import pandas as pd
import pytest
import tyro

from tests.naming import named
from tests.test_cli import call
from tests.training.runs import PPO, SMALL, STEPS
from vergence.commands import extras
from vergence.commands.train import Train, _Watch, _watching
from vergence.controllers.networks.inputs import KINDS
from vergence.files import PARTIAL_PREFIX
from vergence.training.checkpoint import read_checkpoint
from vergence.training.choices import resolve_config
from vergence.training.config import PLANTS

LONG = 10 * STEPS
"""More than is done until the signal comes."""
WORDS = ["train", "gain-schedule", "--seed", "3", "--set", *SMALL, *PPO, "evaluations=10"]


def start(folder: Path) -> subprocess.Popen:
    command = [sys.executable, "-m", "vergence", *WORDS, "--steps", str(LONG), "--out", str(folder)]
    return subprocess.Popen(command, stderr=subprocess.PIPE, text=True)


def wait_for_evaluations(process: subprocess.Popen, number: int) -> None:
    for line in process.stderr:
        number -= " steps: " in line
        if number == 0:
            return
    raise AssertionError(f"ended with {process.wait()} before it was to be stopped")


@pytest.mark.nightly
def test_a_run_killed_in_mid_training_goes_on_to_the_same_number_of_steps(tmp_path, capsys):
    folder = tmp_path / "run"
    process = start(folder)
    wait_for_evaluations(process, 3)
    process.send_signal(signal.SIGKILL)
    process.communicate()
    assert process.returncode == -signal.SIGKILL
    done = read_checkpoint(folder / "checkpoints" / "last.pt")["steps"]
    assert 0 < done < LONG
    # as a kill in the midst of a write leaves it
    left = folder / "checkpoints" / f"{PARTIAL_PREFIX}abc"
    left.mkdir()
    (left / "last.pt").write_bytes(b"half")

    assert call("train", "--resume", str(folder)) == 0
    assert str(folder) in capsys.readouterr().out.replace("\n", "")
    content = read_checkpoint(folder / "checkpoints" / "last.pt")
    assert content["steps"] == LONG
    read_checkpoint(folder / "checkpoints" / "best.pt")
    steps = pd.read_csv(folder / "curve.csv")["step"]
    assert steps.is_monotonic_increasing
    assert steps.is_unique
    assert steps.iloc[[0, -1]].tolist() == [0, LONG]
    assert {done} < set(steps)
    names = {path.name for path in folder.rglob("*")}
    names = {name for name in names if not name.startswith("events.")}
    assert names == {
        *("config.toml", "head.toml", "curve.csv", "curve.png", "curve.svg"),
        *("checkpoints", "best.pt", "last.pt", "tensorboard"),
    }


@pytest.mark.slow
def test_an_interrupted_run_is_saved_and_says_how_to_go_on(tmp_path, capsys, monkeypatch):
    told = _Watch.row

    def row(watch, values):
        told(watch, values)
        if values["step"]:
            signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(_Watch, "row", row)
    folder = tmp_path / "run"
    before = signal.getsignal(signal.SIGINT)
    assert call(*WORDS, "--steps", str(LONG), "--out", str(folder)) == 130
    assert signal.getsignal(signal.SIGINT) is before
    done = read_checkpoint(folder / "checkpoints" / "last.pt")["steps"]
    assert done == LONG // 10
    *_, first, last = capsys.readouterr().err.strip().splitlines()
    assert "interrupted: saving after this update" in first
    assert f"stopped after {done} steps: vergence train --resume {folder} goes on" in last


class InterruptedWhileWriting(io.RawIOBase):
    """A stream at whose first bytes Ctrl-C is pressed."""

    def __init__(self) -> None:
        self.written = []

    def writable(self):
        return True

    def write(self, data):
        self.written.append(bytes(data))
        if len(self.written) == 1:
            signal.raise_signal(signal.SIGINT)
        return len(data)


def test_an_interruption_while_a_line_is_written_is_no_error(tmp_path, monkeypatch, capfd):
    raw = InterruptedWhileWriting()
    monkeypatch.setattr(
        sys, "stderr", io.TextIOWrapper(io.BufferedWriter(raw), line_buffering=True)
    )
    with _watching(tmp_path) as watch:
        print("a line", file=sys.stderr, flush=True)
        assert watch.stop
    assert raw.written == [b"a line\n"]
    assert "interrupted: saving" in capfd.readouterr().err


@pytest.mark.slow
def test_wrong_input_ends_in_one_clear_line_and_exit_code_2(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for words, said in (
        ([], "gain-schedule or policy"),
        (["policy", "--scenario", "nonsense"], "'nonsense'"),
        (["policy", "--algo", "sac"], "algo"),
        (["policy", "--seed", "-1"], "-1"),
        (["policy", "--set", "gamma"], "gamma"),
        (["--resume", "."], "config.toml"),
        (["--resume", ".", "--seed", "1"], "seed"),
        (["--resume", ".", "--no-randomise"], "randomise: expected nothing with --resume"),
        (["nosuch"], "train: expected one of gain-schedule, policy, got 'nosuch'"),
        (["policy", "--plant", "rendered"], "expected one of kinematic, mujoco"),
        (["policy", "--out", "/dev/null"], "/dev/null"),
    ):
        with named(words, said):
            assert call("train", *words) == 2
            out, err = capsys.readouterr()
            assert out == ""
            assert len(err.strip().splitlines()) == 1
            assert said in err
            assert list(tmp_path.iterdir()) == []


def test_randomising_is_what_the_word_says_in_every_kind():
    for kind, word, wanted in [
        ("gain-schedule", "--randomise", True),
        ("policy", "--no-randomise", False),
    ]:
        config, _head = resolve_config(tyro.cli(Train, args=[kind, word]).options)
        assert config.randomise is wanted, kind


def test_the_help_names_the_plants_that_are_accepted_and_where_inputs_are_explained(capsys):
    assert call("train", "--help") == 0
    said = capsys.readouterr().out
    assert f"--plant {{{','.join(PLANTS)}}}" in said
    assert "docs/learning.md" in " ".join(said.replace("│", " ").split())
    page = (Path(__file__).parents[2] / "docs" / "learning.md").read_text()
    assert all(f"| `{kind}` |" in page for kind in KINDS)


def test_without_torch_one_line_says_what_to_install(monkeypatch, capsys):
    monkeypatch.setattr(extras, "find_spec", lambda name: name != "torch" or None)
    assert call("train", "policy") == 2
    (said,) = capsys.readouterr().err.strip().splitlines()
    assert "expected torch to be installed: pip install 'vergence[train]'" in said
