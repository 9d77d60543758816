"""A resumed run is the run that was not interrupted, and refuses what is not its own."""

import re
import shutil
import tomllib
from pathlib import Path

import pandas as pd
import pytest
import tomli_w
import torch

from tests.naming import named
from tests.training.runs import STEPS, Silent, drawn, run_small, small
from vergence.errors import ConfigurationError
from vergence.eval.trials.scenarios import load_scenario
from vergence.files import PARTIAL_PREFIX
from vergence.models import load_head
from vergence.models.head_file import save_head
from vergence.training.checkpoint import read_checkpoint
from vergence.training.config import load_run
from vergence.training.export import export_run
from vergence.training.learner import load_learner
from vergence.training.run import resume, train

RUNS = {
    "gain-schedule": lambda: small(),
    "policy": lambda: small(
        "policy", "normalise_inputs=true", "episodes=2",
        "algorithm.n_steps=8", "algorithm.batch_size=64",
        inputs="predicted", randomise=True, steps=256,
    ),
}  # fmt: skip


def different(ours, theirs, name="") -> list[str]:
    """Names of entries that differ bitwise between two checkpoints; the speed is ignored."""
    if isinstance(ours, dict):
        assert set(ours) == set(theirs)
        pairs = [(f"{name}.{key}", ours[key], theirs[key]) for key in ours if key != "steps_per_s"]
    elif isinstance(ours, list):
        assert len(ours) == len(theirs)
        pairs = [(f"{name}.{i}", *both) for i, both in enumerate(zip(ours, theirs, strict=True))]
    elif isinstance(ours, torch.Tensor):
        return [] if ours.numpy().tobytes() == theirs.numpy().tobytes() else [name]
    else:
        return [] if ours == theirs else [name]
    return [found for part, mine, yours in pairs for found in different(mine, yours, part)]


@pytest.fixture(scope="module")
def stopped(tmp_path_factory):
    """A run stopped at an evaluation that was not its best, never changed."""
    folder = tmp_path_factory.mktemp("runs") / "stopped"
    train(folder, *small(), Silent(stop_after=4))
    assert not read_checkpoint(folder / "checkpoints" / "last.pt")["curve"][-1]["best"]
    return folder


@pytest.fixture
def mine(stopped, tmp_path):
    return shutil.copytree(stopped, tmp_path / "run")


def content_of(folder):
    return {
        path.relative_to(folder): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file() and "tensorboard" not in path.parts
    }


class Killed(BaseException):
    """Ends a run in mid-rollout, without a word to anything that would save it."""


class KillsAt(Silent):
    def __init__(self, steps: int) -> None:
        super().__init__()
        self._last = steps

    def step(self, done: int, total: int) -> None:
        if done >= self._last:
            raise Killed


@pytest.mark.slow
@pytest.mark.parametrize(
    "kind", ["policy", pytest.param("gain-schedule", marks=pytest.mark.nightly)]
)
def test_a_killed_and_a_stopped_run_end_as_the_uninterrupted_one_to_the_last_bit(
    kind, tmp_path, request
):
    config, head = RUNS[kind]()
    if kind == "gain-schedule":
        whole = request.getfixturevalue("whole")
    else:
        whole = train(tmp_path / "whole", config, head, Silent())
    parts = tmp_path / "parts"
    stopped = train(parts, config, head, Silent(stop_after=2))
    assert (stopped.finished, stopped.steps) == (False, config.steps // 4)
    listener = KillsAt(config.steps - 32)  # after the last checkpoint but one, in mid-rollout
    with pytest.raises(Killed):
        resume(parts, listener)
    assert listener.went_on_from == stopped.steps
    left = parts / "checkpoints" / f"{PARTIAL_PREFIX}abc"  # as a kill amid a write leaves it
    left.mkdir()
    (left / "last.pt").write_bytes(b"half")
    listener = Silent()
    assert resume(parts, listener).finished
    assert stopped.steps < listener.went_on_from < config.steps
    assert not left.exists()
    for which in ("last", "best"):
        ours, theirs = (
            read_checkpoint(folder / "checkpoints" / f"{which}.pt")
            for folder in (whole.folder, parts)
        )
        assert different(ours, theirs) == []
    curves = [pd.read_csv(f / "curve.csv") for f in (whole.folder, parts)]
    pd.testing.assert_frame_equal(
        *(curve.drop(columns="steps_per_s") for curve in curves), check_exact=True
    )


@pytest.mark.nightly
def test_a_run_goes_on_to_more_steps_at_the_learning_rate_of_a_run_of_as_many(tmp_path):
    changes = ("final_learning_rate=1e-5", "evaluations=1", "episodes=2")
    config, head = small("gain-schedule", *changes, steps=128)
    first, last = config.algorithm["learning_rate"], config.final_learning_rate
    train(tmp_path / "run", config, head, Silent())
    assert resume(tmp_path / "run", Silent(), steps=256).finished
    assert load_run(tmp_path / "run")[0].steps == 256
    content = read_checkpoint(tmp_path / "run" / "checkpoints" / "last.pt")
    optimizer = content["parameters"]["policy.optimizer"]
    assert optimizer["param_groups"][0]["lr"] == pytest.approx(last, rel=1e-6)
    learner = load_learner(tmp_path / "run", "last")
    assert learner.model.lr_schedule(0.5) == pytest.approx((first + last) / 2)
    learner.close()


@pytest.mark.nightly
def test_a_finished_run_that_could_not_draw_its_figure_draws_it(whole, tmp_path):
    folder = shutil.copytree(whole.folder, tmp_path / "run")
    figures = [folder / "curve.png", folder / "curve.svg"]
    for path in figures:
        path.unlink()
    before = content_of(folder)
    with drawn():
        assert resume(folder, Silent()).finished
    assert {*content_of(folder)} - {*before} == {path.relative_to(folder) for path in figures}
    assert all(path.stat().st_size > 5000 for path in figures)
    assert content_of(folder)[Path("checkpoints/last.pt")] == before[Path("checkpoints/last.pt")]


@pytest.mark.slow
def test_a_run_without_its_last_checkpoint_is_refused_and_keeps_its_best(mine):
    (mine / "checkpoints" / "last.pt").unlink()
    before = content_of(mine)
    with pytest.raises(ConfigurationError, match=r"expected .*last\.pt.* there is .*best\.pt"):
        resume(mine, Silent())
    assert content_of(mine) == before


@pytest.mark.slow
def test_a_run_that_lost_both_checkpoints_is_not_begun_again_over_its_curve(mine):
    shutil.rmtree(mine / "checkpoints")
    with pytest.raises(ConfigurationError, match=r"last\.pt.* there is .*curve\.csv"):
        resume(mine, Silent())


@pytest.mark.slow
def test_a_run_killed_before_its_first_checkpoint_begins_at_zero_and_says_so(mine, stopped):
    shutil.rmtree(mine / "checkpoints")
    header = (mine / "curve.csv").read_text().splitlines()[0]
    (mine / "curve.csv").write_text(header + "\n")
    listener = Silent(stop_after=1)
    resume(mine, listener)
    assert (listener.went_on_from, listener.rows[0]["step"]) == (0, 0)


def test_a_run_whose_best_checkpoint_is_missing_is_refused(mine):
    (mine / "checkpoints" / "best.pt").unlink()
    with pytest.raises(ConfigurationError, match=r"expected .*best\.pt"):
        resume(mine, Silent())


@pytest.mark.slow
def test_a_kill_between_the_names_of_last_and_best_loses_neither(tmp_path):
    folder = tmp_path / "run"
    train(folder, *small(), Silent(stop_after=1))  # the first evaluation is the best so far
    best = folder / "checkpoints" / "best.pt"
    before = read_checkpoint(best)
    best.unlink()
    resume(folder, Silent(stop_after=0))
    assert different(read_checkpoint(best), before) == []


def test_a_flipped_bit_anywhere_in_a_checkpoint_is_found(mine):
    path = mine / "checkpoints" / "last.pt"
    whole = bytearray(path.read_bytes())
    last = len(whole) - 1
    places = {*range(0, 64, 5), *range(last - 160, last, 7), last, *range(0, last, 4999)}
    for place in sorted(places):
        whole[place] ^= 1 << place % 8
        path.write_bytes(whole)
        with pytest.raises(ConfigurationError, match="expected a checkpoint"):
            read_checkpoint(path)
        whole[place] ^= 1 << place % 8
    for length in (0, 10, 64, len(whole) // 2, len(whole) - 1):
        path.write_bytes(whole[:length])
        with pytest.raises(ConfigurationError, match="expected a checkpoint"):
            read_checkpoint(path)
    whole[len(whole) // 2] ^= 1
    path.write_bytes(whole)
    before = content_of(mine)
    with pytest.raises(ConfigurationError, match="damaged"):
        resume(mine, Silent())
    assert content_of(mine) == before


def test_a_checkpoint_of_before_there_were_checksums_is_refused(mine):
    path = mine / "checkpoints" / "last.pt"
    torch.save({"format": 1, "steps": 5}, path)
    with pytest.raises(ConfigurationError, match="a damaged or an older file"):
        resume(mine, Silent())


def test_a_checkpoint_is_an_archive_that_torch_reads(stopped):
    path = stopped / "checkpoints" / "last.pt"
    content = torch.load(path, weights_only=True)
    assert different(content, read_checkpoint(path)) == []


CHANGES = {
    "seed": 7,
    "kind": "policy",
    "network": [16],
    "scenario": "step",
    "plant": "mujoco",
    "envs": 16,
    "episodes": 5,
    "randomise": True,
    "algorithm.learning_rate": 0.01,
    "algorithm.gamma": 0.5,
    "algorithm.ent_coef": 0.25,
    "final_learning_rate": 1e-4,
}


@pytest.mark.slow
def test_an_edited_configuration_is_refused_by_the_name_of_its_field(mine):
    path = mine / "config.toml"
    text = path.read_text()
    for field in CHANGES:
        with named(field):
            content = tomllib.loads(text)
            table, _, name = f"config.{field}".rpartition(".")
            place = content["config"]["algorithm"] if "algorithm" in table else content["config"]
            was, place[name] = place[name], CHANGES[field]
            path.write_text(tomli_w.dumps(content))
            said = re.escape(f"{field} = {CHANGES[field]!r} (was {was!r})")
            before = content_of(mine)
            for way in (lambda: resume(mine, Silent()), lambda: load_learner(mine, "best")):
                with pytest.raises(ConfigurationError, match=said):
                    way()
            with pytest.raises(ConfigurationError, match=said):
                export_run(mine, mine.parent / "mine.vgp")
            assert content_of(mine) == before


def test_all_edited_fields_are_named(mine):
    path = mine / "config.toml"
    text = path.read_text().replace("seed = 0", "seed = 1").replace("episodes = 4", "episodes = 6")
    path.write_text(text)
    with pytest.raises(ConfigurationError, match=r"episodes = 6 \(was 4\), seed = 1 \(was 0\)"):
        resume(mine, Silent())


@pytest.mark.slow
def test_another_number_of_steps_is_no_other_run(mine):
    assert resume(mine, Silent(), steps=STEPS + 128).finished


def test_another_head_is_refused(mine):
    other = load_head("physical")
    save_head(other, mine / "head.toml")
    text = (mine / "config.toml").read_text()
    consistent = text.replace(load_scenario("hardware").model().digest, other.digest)
    for content in (text, consistent):  # the latter of one who copies a folder together
        (mine / "config.toml").write_text(content)
        for way in (lambda: resume(mine, Silent()), lambda: export_run(mine, mine / "mine.vgp")):
            with pytest.raises(ConfigurationError, match=r"head\.toml: expected the head that"):
                way()


@pytest.mark.slow
def test_the_checkpoint_of_another_run_is_refused(mine, tmp_path):
    run_small(tmp_path / "other", "evaluations=1", "episodes=2", seed=4, steps=128)
    shutil.copy(tmp_path / "other" / "checkpoints" / "last.pt", mine / "checkpoints")
    with pytest.raises(ConfigurationError, match=r"seed = 0 \(was 4\)"):
        resume(mine, Silent())


def test_a_value_that_cannot_be_in_an_edited_configuration_is_named_with_its_file(mine):
    path = mine / "config.toml"
    path.write_text(path.read_text().replace("gamma = 0.97", "gamma = 2"))
    with pytest.raises(ConfigurationError, match=r"config\.toml: algorithm\.gamma: .* 0 to 1"):
        resume(mine, Silent())
