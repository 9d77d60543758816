"""Networks on heads of any shape: what they see and put out, and the bundles that fit."""

import numpy as np
import pytest

from tests.controllers.loops import begin
from tests.controllers.networks.graphs import TRAINING, perceptron
from tests.grids import some_of
from tests.heads import head_of
from tests.naming import named
from vergence import load_head, make_controller
from vergence.controllers.networks.bundle import Manifest, write_bundle
from vergence.controllers.networks.environments import GainScheduleTask, PolicyTask, training_env
from vergence.controllers.networks.inputs import KINDS, Inputs
from vergence.envs.task import GazeTask
from vergence.errors import BundleError, ConfigurationError

PER_ACTUATOR = {"to_go": 19, "predicted": 22}
NAMES = {"gain-schedule": "learned-gain", "policy": "learned-policy"}
HEADS = ["tied", "mis", "panfirst", "common", "vergeonly"]


def test_there_is_a_number_of_each_channel_for_every_actuator() -> None:
    for kind, name in some_of(sorted(PER_ACTUATOR), HEADS):
        with named(kind, name):
            head = head_of(name)
            task = begin(GazeTask(6, plant="kinematic", head=head), 3)
            inputs = Inputs(kind, head, task.layout)
            assert inputs.size == PER_ACTUATOR[kind] * head.actuation.count
            for actuator in head.actuation.names:
                own = [one for one in inputs.names if one.endswith(f"_{actuator}")]
                assert len(own) == PER_ACTUATOR[kind]
            memory = np.tile(inputs.initial(), (6, 1))
            rng = np.random.default_rng(0)
            for _ in range(30):
                values, _now = inputs.update(task.layout.decode(task.encoded), memory)
                assert values.shape == (6, inputs.size)
                assert (np.abs(values) <= 1.0).all()
                task.step(rng.uniform(-1, 1, (6, head.actuation.count)))
            # the rates of targets at rest are none: two channels
            assert values.any(axis=0).mean() > 0.9 * (1.0 - 2.0 / PER_ACTUATOR[kind])
            assert Inputs.from_dict(inputs.to_dict(), head).names == inputs.names


def test_the_names_of_the_first_heads_inputs_are_those_that_bundles_hold() -> None:
    for kind in sorted(KINDS):
        with named(kind):
            assert Inputs(kind, load_head("physical")).names == KINDS[kind]


def test_a_network_for_each_joint_is_for_heads_that_have_a_motor_for_each() -> None:
    assert Inputs("to_go", head_of("panfirst")).by_joint.shape == (4, 19)
    assert Inputs("to_go", head_of("tied")).by_joint is None


def test_a_policy_has_an_action_for_each_actuator_and_a_schedule_four_gains() -> None:
    for name in HEADS:
        with named(name):
            head = head_of(name)
            for make, size in ((PolicyTask, head.actuation.count), (GainScheduleTask, 4)):
                task = begin(make(2, plant="kinematic", head=head), 3)
                observed, action = task.spaces()
                assert action.shape == (size,)
                for _ in range(10):
                    task.step(np.full((2, size), 0.5, dtype=np.float32))
                assert task.observation.shape[1:] == observed.shape
                task.close()


def test_a_bundle_of_a_head_runs_on_it_and_on_no_other(tmp_path) -> None:
    for kind, name in some_of(sorted(NAMES), HEADS):
        with named(kind, name):
            head = head_of(name)
            inputs = Inputs("to_go", head)
            outputs = 4 if kind == "gain-schedule" else head.actuation.count
            network = perceptron(inputs.size, outputs=outputs)
            path = tmp_path / f"{kind}-{name}.vgp"
            write_bundle(path, Manifest.of(kind, inputs, network, TRAINING, {}), network)
            controller = make_controller(NAMES[kind], head, bundle=path)
            seen = np.zeros((3, inputs.layout.size), dtype=np.float32)
            assert controller.predict(seen)[0].shape == (3, head.actuation.count)
            fits = rf"for simulated \(.*\), got one for {head.name} \({head.digest[:12]}\) alone"
            with pytest.raises(BundleError, match=fits):
                make_controller(NAMES[kind], load_head("simulated"), bundle=path)


def test_a_network_learns_in_the_vector_environment_of_any_head() -> None:
    for kind in sorted(NAMES):
        with named(kind):
            head = head_of("tied")
            env = training_env(kind, 4, plant="kinematic", head=head)
            env.reset(seed=0)
            size = env.single_action_space.shape[0]
            assert size == (4 if kind == "gain-schedule" else 3)
            observation, reward, *_ = env.step(np.full((4, size), 0.5, dtype=np.float32))
            assert observation.shape == (4, *env.single_observation_space.shape)
            assert np.isfinite(reward).all()
            names = "left_v" if kind == "gain-schedule" else "tilt, version, vergence"
            expected = rf"expected shape \(4, {size}\), heads by {names}"
            with pytest.raises(ConfigurationError, match=expected):
                env.step(np.zeros((4, size + 1), dtype=np.float32))
            env.close()
