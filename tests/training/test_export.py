"""Exported networks do what the trained ones do, and the command writes them as bundles."""

import shlex

import gymnasium
import numpy as np
import pytest
import torch
import tyro
from gymnasium.spaces import Box
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize
from torch import nn

from tests.heads import text_of
from tests.test_cli import call
from tests.training.runs import Silent
from vergence import make_controller
from vergence.commands.train import Train
from vergence.controllers.adaptive import gains_from_action
from vergence.controllers.networks.bundle import read_bundle
from vergence.controllers.networks.environments import decode_velocity_action
from vergence.controllers.networks.inputs import Inputs
from vergence.controllers.networks.learned import load_policy
from vergence.controllers.networks.runtime import Runtime
from vergence.errors import BundleError, ConfigurationError
from vergence.eval.trials.run import run_trials
from vergence.eval.trials.scenarios import load_scenario
from vergence.training import onnx_export
from vergence.training.choices import resolve_config
from vergence.training.config import load_run
from vergence.training.export import export_run
from vergence.training.learner import load_learner
from vergence.training.networks import JointwisePolicy
from vergence.training.onnx_export import (
    TOLERANCE,
    check_agreement,
    export_network,
    learner_network,
)
from vergence.training.options import TrainOptions
from vergence.training.run import train

SIZE = 12
BRIEF = (
    "evaluations=1", "episodes=2", "network=[16]",
    "algorithm.n_steps=16", "algorithm.batch_size=64", "algorithm.n_epochs=1",
)  # fmt: skip


class Room(gymnasium.Env):
    """Nothing but spaces: networks need no more to be made."""

    observation_space = Box(-1.0, 1.0, (SIZE,), np.float32)
    action_space = Box(-1.0, 1.0, (4,), np.float32)


def room() -> VecNormalize:
    """An environment with statistics, some of inputs that hardly vary."""
    env = VecNormalize(DummyVecEnv([Room]))
    rng = np.random.default_rng(0)
    env.obs_rms.mean = rng.uniform(-0.5, 0.5, SIZE)
    env.obs_rms.var = rng.uniform(0.01, 1.0, SIZE)
    env.obs_rms.var[:2] = 1e-6
    return env


def learner(activation: type[nn.Module] = nn.Tanh, **options):
    """A learner with weights as large as those of trained networks."""
    policy = {"net_arch": [32, 32], "activation_fn": activation}
    model = PPO("MlpPolicy", room(), policy_kwargs=policy, device="cpu", seed=0, **options)
    with torch.no_grad():
        for parameter in model.policy.parameters():
            parameter.mul_(1.5)
        model.policy.action_net.weight.mul_(100.0)  # the last layer begins at a hundredth
    return model


class Unexported:
    """Stands for a network and for what runs it: the actor that would be exported."""

    def __init__(self, actor, size):
        self.actor, self.input_size = actor, size

    def __call__(self, inputs):
        with torch.no_grad():
            return self.actor(torch.as_tensor(inputs)).numpy()


@pytest.mark.parametrize("exported", [False, pytest.param(True, marks=pytest.mark.nightly)])
@pytest.mark.parametrize("kind", ["gain-schedule", "policy"])
def test_a_network_and_its_learner_agree_on_10000_observations(kind, exported, monkeypatch):
    if not exported:
        monkeypatch.setattr(onnx_export, "export_network", Unexported)
        monkeypatch.setattr(onnx_export, "Runtime", lambda network: network)
    model = learner()
    env = model.get_vec_normalize_env()
    network, difference = learner_network(kind, model, env)
    assert difference <= TOLERANCE
    x = np.random.default_rng(1).uniform(-1, 1, (10_000, SIZE)).astype("f4")
    action, _state = model.predict(env.normalize_obs(x).astype("f4"), deterministic=True)
    out = onnx_export.Runtime(network)(x)
    assert action.std() > 0.2  # neither rests nor saturates everywhere
    if kind == "policy":
        assert np.abs(out - decode_velocity_action(action)).max() <= 1e-5
    else:
        # by eye and image axis; in the order of the joints, v comes first
        gains = 10.0 * (1.0 + out.reshape(-1, 2, 2)[..., ::-1])
        assert np.abs(gains - gains_from_action(action)).max() <= 1e-4


@pytest.mark.nightly
def test_other_activations_and_layers_are_exported():
    kinds = (nn.ReLU, nn.ELU, nn.SiLU, nn.GELU, nn.LeakyReLU, nn.Mish)
    layers = [module for kind in kinds for module in (nn.Linear(SIZE, SIZE), kind())]
    actor = nn.Sequential(nn.Flatten(), *layers, nn.LayerNorm(SIZE), nn.Linear(SIZE, 4))
    network = export_network(actor, SIZE)

    def act(inputs):
        with torch.no_grad():
            return actor(torch.as_tensor(inputs)).numpy()

    assert check_agreement(network, act) <= TOLERANCE


@pytest.mark.nightly
def test_the_network_shared_by_the_joints_is_exported():
    by_joint = np.arange(SIZE).reshape(3, 4).T.tolist()
    options = {"net_arch": [8, 8], "by_joint": by_joint, "critic": (8,)}
    model = PPO(JointwisePolicy, room(), policy_kwargs=options, device="cpu", seed=0)
    with torch.no_grad():
        model.policy.action_net.out.weight.mul_(100.0)
    network, _difference = learner_network("gain-schedule", model, None)
    assert network.output_size == 4


@pytest.mark.slow
def test_nothing_of_the_machine_that_exported_it_is_in_the_file(bundle):
    network = read_bundle(bundle).network
    assert network.operators <= {"Add", "Clip", "Div", "Gemm", "Mul", "Pow", "Sub", "Tanh"}
    for word in (b"/", b".py", b"torch.nn"):
        assert word not in network.data.replace(b"pkg", b"")[:64]
    assert b"site-packages" not in network.data
    assert b"metadata" not in network.data


@pytest.mark.slow
def test_a_difference_is_found(bundle):
    network = read_bundle(bundle).network
    with pytest.raises(BundleError, match="expected ONNX and torch to agree to 1e-05, got"):
        check_agreement(network, lambda inputs: Runtime(network)(inputs) + 2e-5)


@pytest.mark.nightly
def test_an_actor_of_other_operators_is_refused():
    with pytest.raises(BundleError, match=r"expected operators among .*'Softmax'"):
        export_network(nn.Sequential(nn.Linear(SIZE, 4), nn.Softmax(-1)), SIZE)


def test_other_bounds_of_actions_are_refused():
    model = learner()
    model.action_space = Box(-2.0, 2.0, (4,), np.float32)
    with pytest.raises(ConfigurationError, match="four actions from -1 to 1"):
        learner_network("policy", model, None)


# From a run folder.


def trained(folder, kind, head=None):
    """A brief run for a preset, or for a head in a file beside the folder."""
    if head is not None:
        (folder.parent / f"{head}.toml").write_text(text_of(head))
        head = str(folder.parent / f"{head}.toml")
    options = TrainOptions(kind=kind, head=head, seed=5, steps=128, envs=4, set=BRIEF)
    train(folder, *resolve_config(options), Silent())
    return folder


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A run for a head of three actuators, some of which move two joints."""
    return trained(tmp_path_factory.mktemp("runs") / "run", "policy", "tied")


@pytest.fixture(scope="module")
def bundle(run, tmp_path_factory):
    """The bundle that the command makes of the run's last checkpoint, in the place of a file."""
    out = tmp_path_factory.mktemp("bundles") / "mine.vgp"
    out.write_text("mine")
    words = (str(run), str(out), "--checkpoint", "last")
    assert call("export", "bundle", *words) == 2
    assert out.read_text() == "mine"
    assert call("export", "bundle", *words, "--force") == 0
    return out


@pytest.mark.slow
def test_a_run_is_exported_to_a_bundle_that_runs(bundle):
    manifest = read_bundle(bundle).manifest
    assert manifest.kind == "policy"
    assert manifest.training["seed"] == 5
    assert manifest.training["steps"] == 128
    assert manifest.training["checkpoint"] == {"name": "last", "step": 128}
    assert manifest.training["command"].startswith("vergence train policy --scenario hardware")
    assert "--seed 5" in manifest.training["command"]
    assert "torch" in manifest.training["versions"]
    assert manifest.metrics["onnx_difference"] <= 1e-5
    assert set(manifest.metrics["validation"]) >= {"headline", "settled_fraction"}


def command_of(bundle, head):
    scenario = load_scenario("workspace")
    command = run_trials(load_policy(bundle, head), scenario, episodes=2, head=head).command
    assert np.isfinite(command).all()
    return command


@pytest.mark.slow
def test_a_bundle_moves_a_head_with_tied_joints(run, bundle):
    head = load_run(run)[1]
    content = read_bundle(bundle)
    assert content.manifest.head["digest"] == head.digest
    assert content.network.output_size == 3
    command = command_of(bundle, head)
    assert command[..., :3].any()
    assert not command[..., 3:].any()  # it has three actuators


@pytest.mark.nightly
@pytest.mark.parametrize(("kind", "shape"), [("gain-schedule", "tied"), ("policy", None)])
def test_a_network_is_learned_and_exported_for_either_kind_of_head(tmp_path, kind, shape):
    folder = trained(tmp_path / "run", kind, shape)
    manifest = export_run(folder, tmp_path / "mine.vgp", "last")
    assert manifest.metrics["onnx_difference"] <= 1e-5
    assert read_bundle(tmp_path / "mine.vgp").network.output_size == 4
    command_of(tmp_path / "mine.vgp", load_run(folder)[1])


@pytest.mark.slow
def test_the_exported_network_acts_as_the_learner_does(run, bundle):
    learned = load_learner(run, "last")
    head = load_run(run)[1]
    bundled = make_controller("learned-policy", head, bundle=bundle)
    layout = bundled.layout
    rng = np.random.default_rng(0)
    seen = rng.uniform(layout.low(), layout.high(), (200, layout.size)).astype("f4")
    expected, _state = learned.controller().predict(seen)
    learned.close()
    assert bundled.inputs.to_dict() == Inputs.of("to_go", head).to_dict()
    assert bundled.predict(seen)[0] == pytest.approx(expected, abs=1e-5)


@pytest.mark.slow
def test_the_command_in_the_manifest_makes_the_same_configuration(run, bundle):
    program, name, *words = shlex.split(read_bundle(bundle).manifest.training["command"])
    assert (program, name) == ("vergence", "train")
    config, _head = resolve_config(tyro.cli(Train, args=words).options)
    assert config == load_run(run)[0]


@pytest.mark.slow
def test_the_command_refuses_in_one_line(run, tmp_path, capsys):
    taken = tmp_path / "taken.vgp"
    taken.write_text("mine")
    for words, said in (
        ([str(run), str(taken)], "--force"),
        ([str(run), str(tmp_path / "out.zip")], ".vgp"),
        ([str(tmp_path / "nothing"), str(tmp_path / "out.vgp")], "nothing"),
        ([str(tmp_path), str(tmp_path / "out.vgp")], "training run"),
    ):
        assert call("export", "bundle", *words) == 2
        out, err = capsys.readouterr()
        assert out == ""
        assert len(err.strip().splitlines()) == 1
        assert said in err
    assert [p.name for p in tmp_path.iterdir()] == ["taken.vgp"]
