"""A training that diverges, and one whose disk is full: one line, and what was good is kept."""

import errno
import os
import shutil

import pytest
import torch

from tests.naming import named
from tests.test_cli import call
from tests.training.runs import PPO, SMALL, STEPS, Silent, small
from tests.training.test_resume import content_of, different
from vergence import files
from vergence.errors import ConfigurationError, TrainingDivergedError
from vergence.training.checkpoint import read_checkpoint
from vergence.training.run import resume, train


@pytest.mark.slow
@pytest.mark.filterwarnings("error")
def test_a_training_that_diverges_says_when_and_what_to_try(tmp_path):
    folder = tmp_path / "run"
    with pytest.raises(TrainingDivergedError) as caught:
        train(folder, *small("gain-schedule", "algorithm.learning_rate=1e30"), Silent())
    said = str(caught.value)
    assert "became nan" in said
    assert "after 256 steps; the checkpoint of 128 steps is kept" in said
    assert "--set algorithm.learning_rate" in said
    for which in ("best", "last"):
        content = read_checkpoint(folder / "checkpoints" / f"{which}.pt")
        assert all(torch.isfinite(t).all() for t in content["parameters"]["policy"].values())
    assert "nan" not in (folder / "curve.csv").read_text()


@pytest.mark.nightly
def test_a_run_that_diverged_does_so_again_when_it_goes_on(tmp_path):
    folder = tmp_path / "run"
    config, head = small("policy", "algorithm.learning_rate=1e30")
    for again in (lambda: train(folder, config, head, Silent()), lambda: resume(folder, Silent())):
        with pytest.raises(TrainingDivergedError, match="after 256 steps"):
            again()


@pytest.mark.slow
def test_the_command_ends_a_diverged_training_with_one_line(tmp_path, capsys):
    words = ["--set", *SMALL, *PPO, "algorithm.learning_rate=1e30", "--steps", str(STEPS)]
    assert call("train", "policy", "--out", str(tmp_path / "run"), *words) == 2
    lines = capsys.readouterr().err.strip().splitlines()
    assert [line for line in lines if "steps/s" not in line and "to beat" not in line] == lines[-1:]
    assert lines[-1].startswith("vergence: error: training diverged")


@pytest.mark.nightly
def test_a_disk_that_fails_in_mid_training_costs_nothing_that_was_saved(
    whole, begun, tmp_path, monkeypatch
):
    for number, good in [(errno.EACCES, 0), (errno.ENOSPC, 2)]:
        with named(number, good):
            folder = shutil.copytree(begun, tmp_path / f"run-{good}")
            _fail_to_rename(folder, number, good, monkeypatch)
    resume(folder, Silent())
    ours, theirs = (read_checkpoint(f / "checkpoints" / "last.pt") for f in (folder, whole.folder))
    assert different(ours["parameters"], theirs["parameters"]) == []


def _fail_to_rename(folder, number, good, monkeypatch):
    saved = read_checkpoint(folder / "checkpoints" / "last.pt")
    calls = iter(range(10**6))

    def replace(source, target):
        if next(calls) >= good:
            raise OSError(number, os.strerror(number))
        return rename(source, target)

    rename = os.replace
    with monkeypatch.context() as patch:
        patch.setattr(files.os, "replace", replace)
        with pytest.raises(ConfigurationError) as caught:
            resume(folder, Silent())
    assert os.strerror(number) in str(caught.value)
    assert f"vergence train --resume {folder} goes on" in str(caught.value)
    assert not list(folder.rglob(f"{files.PARTIAL_PREFIX}*"))
    assert read_checkpoint(folder / "checkpoints" / "last.pt")["steps"] >= saved["steps"]


@pytest.mark.slow
def test_a_folder_that_cannot_be_written_any_more_is_said_in_one_line(
    begun, tmp_path, monkeypatch, capsys
):
    folder = shutil.copytree(begun, tmp_path / "run")
    before = content_of(folder)

    def mkdtemp(*_words, **_more):
        raise OSError(errno.EACCES, os.strerror(errno.EACCES))

    monkeypatch.setattr(files.tempfile, "mkdtemp", mkdtemp)
    assert call("train", "--resume", str(folder)) == 2
    said = capsys.readouterr().err.strip().splitlines()
    assert [line for line in said if "Permission denied" in line] == said[-1:]
    assert content_of(folder) == before
