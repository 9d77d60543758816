"""The comparison of interrupted trainings runs, and says that they end alike."""

import pytest

from benchmarks.resumed_training import main
from tests.training.runs import PPO, SMALL


@pytest.mark.nightly
@pytest.mark.usefixtures("undrawn")
def test_an_interrupted_training_is_said_to_end_as_an_uninterrupted_one(capsys) -> None:
    assert main(["--steps", "512", "--seeds", "3", "--set", *SMALL, *PPO]) == 0
    row = next(line for line in capsys.readouterr().out.splitlines() if "256 steps" in line)
    assert "yes" in row
