"""Training runs: what they write, that they repeat, and that they go on."""

import tomllib

import numpy as np
import pandas as pd
import pytest
import torch
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from tests.training.runs import STEPS, Silent, run_small, small
from vergence.errors import ConfigurationError, VergenceError
from vergence.models import load_head
from vergence.training.checkpoint import read_checkpoint, write_checkpoint
from vergence.training.config import load_run
from vergence.training.curve import COLUMNS
from vergence.training.learner import load_learner
from vergence.training.run import resume, train


@pytest.fixture(scope="module")
def run(whole):
    return whole


def parameters(folder, which="last"):
    return read_checkpoint(folder / "checkpoints" / f"{which}.pt")["parameters"]


@pytest.mark.slow
def test_a_run_folder_says_all_that_is_needed_to_run_again(run):
    content = tomllib.loads((run.folder / "config.toml").read_text())
    assert {"torch", "stable-baselines3", "python"} <= set(content["versions"])
    assert content["head"]["digest"] == load_head(str(run.folder / "head.toml")).digest
    config, head = load_run(run.folder)
    expected, known = small()
    assert (config, head.digest) == (expected, known.digest)


def test_the_curve_has_a_row_for_each_evaluation_beside_the_tuned_baseline(run):
    assert (run.finished, run.steps) == (True, STEPS)
    assert set(run.baselines) == {"ibvs-tuned", "state-feedback", "saccade"}
    baseline = min(score.headline for score in run.baselines.values())
    table = pd.read_csv(run.folder / "curve.csv")
    assert list(table.columns) == list(COLUMNS)
    assert list(table["step"]) == [0, STEPS // 4, STEPS // 2, 3 * STEPS // 4, STEPS]
    assert list(table["baseline"]) == [pytest.approx(baseline)] * 5
    assert list(table["gain"] * table["headline"]) == pytest.approx(list(table["baseline"]))
    assert {path.name for path in run.folder.glob("curve.*g")} == {"curve.png", "curve.svg"}


def test_the_best_checkpoint_is_the_best_row_of_the_curve(run):
    rows = read_checkpoint(run.folder / "checkpoints" / "last.pt")["curve"]
    best = min(rows, key=lambda row: row["rank"])
    assert read_checkpoint(run.folder / "checkpoints" / "best.pt")["steps"] == best["step"]


def test_tensorboard_has_the_validation(run):
    events = EventAccumulator(str(run.folder / "tensorboard"))
    events.Reload()
    headlines = events.Scalars("validation/headline")
    assert [event.step for event in headlines] == [row["step"] for row in run.rows]
    assert [event.value for event in headlines] == pytest.approx(
        [row["headline"] for row in run.rows]
    )
    assert "train/value_loss" in events.Tags()["scalars"]


@pytest.mark.slow
def test_another_seed_gives_another_network(begun, tmp_path):
    train(tmp_path / "other", *small(seed=1), Silent(stop_after=2))
    others = parameters(tmp_path / "other")["policy"]
    for name, tensor in parameters(begun)["policy"].items():
        assert not torch.equal(tensor, others[name]) or not tensor.any(), name


def test_what_is_restored_is_what_was_saved(run):
    learner = load_learner(run.folder, "last")
    content = read_checkpoint(run.folder / "checkpoints" / "last.pt")
    assert learner.model.num_timesteps == STEPS
    for name, tensor in content["parameters"]["policy"].items():
        assert torch.equal(learner.model.policy.state_dict()[name], tensor)
    saved = content["parameters"]["policy.optimizer"]["state"]
    mine = learner.model.policy.optimizer.state_dict()["state"]
    assert saved
    for key, moments in saved.items():
        for name, value in moments.items():
            assert torch.equal(torch.as_tensor(mine[key][name]), torch.as_tensor(value))
    assert not learner.normalisation.obs_rms.mean.any()  # inputs are not normalised
    statistics = learner.normalisation.ret_rms
    assert (statistics.var, statistics.count) == (
        float(content["returns"]["var"]),
        content["returns"]["count"],
    )
    assert torch.equal(torch.get_rng_state(), content["random"]["torch"])
    learner.close()


@pytest.mark.slow
def test_the_controller_of_a_run_settles_as_the_curve_says(run):
    from vergence.training.validation import Validation

    learner = load_learner(run.folder, "best")
    config = learner.config
    validation = Validation(
        learner.scenario, learner.head, config.plant, config.seed, config.episodes
    )
    best = min(run.rows, key=lambda row: row["rank"])
    assert validation.score(learner.controller()).mean == best["mean"]
    learner.close()


@pytest.mark.slow
def test_a_policy_is_learned_from_normalised_inputs(tmp_path):
    changes = ("normalise_inputs=true", "evaluations=1", "episodes=2")
    result = run_small(tmp_path / "run", *changes, kind="policy", steps=128, randomise=True)
    assert result.steps == 128
    learner = load_learner(result.folder, "last")
    assert np.abs(learner.normalisation.obs_rms.mean).max() > 0.0
    learner.close()


def test_a_finished_run_does_not_go_on_but_to_more_steps(run):
    with pytest.raises(ConfigurationError, match=f"expected more than the {STEPS} steps"):
        resume(run.folder, Silent())


def test_a_run_folder_is_never_trained_in_anew(run):
    with pytest.raises(ConfigurationError, match=f"--resume {run.folder}"):
        train(run.folder, *small(), Silent())


class Evil:
    def __reduce__(self):
        return print, ("ran",)


def test_a_checkpoint_runs_nothing(tmp_path, capsys):
    path = tmp_path / "last.pt"
    with pytest.raises(ConfigurationError, match="No such file"):
        read_checkpoint(path)
    torch.save({"format": 1, "steps": Evil()}, path)
    with pytest.raises(ConfigurationError, match="expected a checkpoint"):
        read_checkpoint(path)
    assert capsys.readouterr().out == ""


def test_a_checkpoint_that_cannot_be_written_leaves_the_one_before(tmp_path):
    path = tmp_path / "last.pt"
    write_checkpoint(path, {"steps": 1})
    with pytest.raises(AttributeError):
        write_checkpoint(path, {"steps": lambda: None})
    assert read_checkpoint(path)["steps"] == 1
    assert [file.name for file in tmp_path.iterdir()] == ["last.pt"]


WRONG = [
    (("nonsense=1",), "nonsense=1"),
    (("steps=2.5",), "steps: expected a value of type int, got 2.5"),
    (("network=[]",), "network"),
    (("activation=sine",), "'sine'"),
    (("algorithm.nonsense=1",), "nonsense"),
    (("algorithm.batch_size=100",), "batch_size: expected a divisor"),
    (("algorithm.learning_rate=-1",), r"algorithm\.learning_rate: .* above 0, got -1"),
    (("algorithm.learning_rate=nan",), "got nan"),
    (("algorithm.learning_rate=fast",), "got 'fast'"),
    (("algorithm.gamma=2",), "algorithm.gamma: expected a number from 0 to 1, got 2"),
    (("algorithm.n_steps=0",), "algorithm.n_steps: expected a whole number from 1, got 0"),
    (("algorithm.batch_size=-1",), "algorithm.batch_size: expected a whole number from 2"),
    (("algorithm.normalize_advantage=1",), "expected true or false, got 1"),
    (("algorithm.seed=3",), r"algorithm\.seed"),
    (("network=[64.0]",), "network"),
    (("network=64",), "network: expected a value of type list, got 64"),
    (("network=[100000]",), "from 1 to 4096"),
    (("network=[4096,4096]",), "at most 1048576 weights"),
    (("critic=[0]",), "critic"),
    (("log_std_init=nan",), "log_std_init"),
    (("final_learning_rate=-1",), "final_learning_rate"),
    (("envs=1000000000000",), "envs: expected a whole number from 1 to 1048576"),
    (("threads=100000",), "threads"),
    (("randomise=perhaps",), "randomise: expected a value of type bool"),
    (("inputs=observation",), "inputs: expected one of predicted, to_go, got 'observation'"),
]


@pytest.mark.slow
def test_choices_that_cannot_be_are_refused_before_anything_is_written(tmp_path):
    for changes, said in WRONG:
        with pytest.raises(VergenceError, match=said):
            run_small(tmp_path / "run", *changes)
        assert list(tmp_path.iterdir()) == [], changes
