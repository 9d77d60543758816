"""Learned controllers: from a bundle to actions, and nothing executed on the way."""

import ast
import copy
import json
import pickle
import re
import sys
from pathlib import Path

import numpy as np
import pytest

from tests.controllers.networks.graphs import KINDS, bundle_of, forward, onnx_file
from tests.grids import some_of
from tests.naming import named
from vergence import load_head, make_controller
from vergence.controllers.ibvs import ibvs_velocities
from vergence.controllers.networks import learned
from vergence.controllers.networks.bundle import pretrained_bundles, read_bundle
from vergence.controllers.networks.learned import LearnedGain, LearnedPolicy, load_policy
from vergence.controllers.networks.onnx import bundle_as_onnx
from vergence.envs.observation import ObservationLayout
from vergence.errors import BundleError, ConfigurationError
from vergence.eval.margins.run import with_imperfection
from vergence.eval.trials.run import run_trials
from vergence.eval.trials.scenarios import load_scenario

PACKAGE = Path(learned.__file__).parents[2]
HEAD = load_head("simulated")
NAMES = {"gain-schedule": "learned-gain", "policy": "learned-policy"}


@pytest.fixture(scope="module")
def bundles(tmp_path_factory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("bundles")
    return {kind: bundle_of(folder, kind) for kind in KINDS}


def observations(shape: tuple[int, ...]) -> np.ndarray:
    """Any observations of the simulated head, with the target in sight."""
    layout = ObservationLayout.of(HEAD)
    rng = np.random.default_rng(0)
    drawn = rng.uniform(layout.low(), layout.high(), (*shape, layout.size)).astype("f4")
    drawn[..., layout.fields["visible"]] = 1.0
    return drawn


def test_a_policy_puts_out_the_action(bundles):
    controller = make_controller("learned-policy", HEAD, bundle=bundles["policy"])
    assert isinstance(controller, LearnedPolicy)
    seen = observations((40,))
    action, _state = controller.predict(seen)
    inputs, _now = controller.inputs.update(
        controller.layout.decode(seen), np.tile(controller.inputs.initial(), (40, 1))
    )
    assert action.dtype == np.float32
    assert action == pytest.approx(forward(inputs) ** 3, abs=1e-6)


def test_a_gain_schedule_puts_out_the_gains_of_the_law(bundles):
    controller = make_controller("learned-gain", HEAD, bundle=bundles["gain-schedule"])
    assert isinstance(controller, LearnedGain)
    seen = observations((40,))
    inputs, _now = controller.inputs.update(
        controller.layout.decode(seen), np.tile(controller.inputs.initial(), (40, 1))
    )
    names, outputs = controller.manifest.actions["names"], 5.0 * (1.0 + forward(inputs).T) ** 2
    by_name = dict(zip(names, outputs, strict=True))
    gains = np.array([[by_name[f"{eye}_{axis}"] for axis in "uv"] for eye in ("left", "right")])
    now, layout = controller.layout.decode(seen), controller.layout
    command = ibvs_velocities(
        HEAD, now.positions_at_exposure, now.pixel_error, np.moveaxis(gains, -1, 0), np.nan,
        layout.action_limits,
    )  # fmt: skip
    expected = layout.action(command)
    assert controller.predict(seen)[0] == pytest.approx(expected, abs=1e-5)


def test_one_head_is_to_the_bit_a_row_of_a_batch_of_any_size():
    for bundle in pretrained_bundles().values():
        network = read_bundle(bundle).network
        rng = np.random.default_rng(0)
        x = rng.uniform(-1, 1, (700, network.input_size)).astype("f4")
        together = network(x)
        for rows in (0, 1, 3, 64, 257):
            with named(bundle.stem, rows):
                assert np.array_equal(network(x[:rows]), together[:rows])


def test_a_copy_acts_alike(bundles):
    for kind in KINDS:
        with named(kind):
            controller = make_controller(NAMES[kind], HEAD, bundle=bundles[kind])
            seen = observations((7,))
            for other in (copy.deepcopy(controller), pickle.loads(pickle.dumps(controller))):
                assert np.array_equal(other.predict(seen)[0], controller.predict(seen)[0])


def test_outputs_that_are_no_numbers_leave_the_eyes_at_rest(bundles):
    for kind in KINDS:
        with named(kind):
            controller = make_controller(NAMES[kind], HEAD, bundle=bundles[kind])
            controller._network = lambda inputs: np.full((*inputs.shape[:-1], 4), np.nan, "f4")
            assert not controller.predict(observations((3,)))[0].any()


def test_a_bare_network_sees_the_observation_and_is_limited(tmp_path):
    for batch in ("batch", 1):
        with named(batch):
            controller = load_policy(onnx_file(tmp_path / "mine.onnx", batch=batch), HEAD)
            seen = observations((2, 3))
            expected = np.clip(9.0 * seen.sum(axis=-1, keepdims=True), -1.0, 1.0)
            action, state = pickle.loads(pickle.dumps(controller)).predict(seen)
            assert action == pytest.approx(np.repeat(expected, 4, axis=-1), abs=1e-4)
            assert state is None
            assert controller.predict(seen[:0])[0].shape == (0, 3, 4)
    with pytest.raises(ConfigurationError, match="nan"):
        controller.predict(np.full(27, np.nan, "f4"))


def test_a_bare_networks_weights_lie_beside_it(tmp_path, monkeypatch):
    outside = {"save_as_external_data": True, "location": "w.data", "size_threshold": 0}
    for folder, weight in (("own", 9.0), ("other", 0.0)):
        (tmp_path / folder).mkdir()
        onnx_file(tmp_path / folder / "mine.onnx", weight=weight, **outside)
    monkeypatch.chdir(tmp_path / "other")
    controller = load_policy(tmp_path / "own" / "mine.onnx", HEAD)
    assert pickle.loads(pickle.dumps(controller)).predict(observations((2,)))[0].any()
    (tmp_path / "own" / "w.data").unlink()
    with pytest.raises(BundleError, match=r"mine.onnx: network: expected an ONNX model that can"):
        load_policy(tmp_path / "own" / "mine.onnx", HEAD)


def test_a_bundle_is_loaded_by_what_it_says_it_is(bundles):
    for kind in KINDS:
        with named(kind):
            by_name = make_controller(NAMES[kind], HEAD, bundle=bundles[kind])
            seen, found = observations((4,)), load_policy(bundles[kind], HEAD)
            assert np.array_equal(found.predict(seen)[0], by_name.predict(seen)[0])


def test_what_does_not_fit_is_refused_with_the_files_name(bundles, tmp_path):
    for name, bundle in (("learned-gain", "policy"), ("learned-policy", "gain-schedule")):
        with pytest.raises(BundleError, match=rf"{bundle}.vgp: kind: expected .*, got '{bundle}'"):
            make_controller(name, HEAD, bundle=bundles[bundle])
    with pytest.raises(BundleError, match=r"policy.vgp: .*expected .* for head .*, got"):
        load_policy(bundles["policy"], load_head("physical"))
    for options, match in (
        ({"size": 26}, "expected 27 inputs, got 26"),
        ({"outputs": 3}, "expected 4 outputs, got 3"),
        ({"batch": 4}, "expected one that runs on any batch, got"),
        ({"last": "RandomNormalLike"}, "expected rows of a batch that do not depend on each"),
        ({"last": "ReduceMax"}, "expected 4 outputs, got None"),
    ):
        path = onnx_file(tmp_path / "mine.onnx", **options)
        with pytest.raises(BundleError, match=rf"mine.onnx: network: {match}"):
            load_policy(path, HEAD)
    (tmp_path / "policy.zip").write_bytes(b"")
    with pytest.raises(BundleError, match=r"named \*.vgp or \*.onnx"):
        load_policy(tmp_path / "policy.zip", HEAD)
    (tmp_path / "bad.onnx").write_bytes(b"import os")
    with pytest.raises(BundleError, match=r"bad.onnx: network: "):
        load_policy(tmp_path / "bad.onnx", HEAD)


def test_a_head_with_other_steps_and_noise_is_the_same_head_for_a_bundle(bundles):
    coarse = load_scenario("hardware").model()
    assert coarse.digest != HEAD.digest
    controller = make_controller("learned-policy", coarse, bundle=bundles["policy"])
    assert controller.head is coarse
    assert make_controller("learned-gain", coarse).manifest.head["name"] == "simulated"
    slower = coarse.replace(timing={"lag_s": 0.05})
    with pytest.raises(BundleError, match="allow_other_head"):
        make_controller("learned-policy", slower, bundle=bundles["policy"])
    make_controller("learned-policy", slower, bundle=bundles["policy"], allow_other_head=True)
    load_policy(bundles["policy"], slower, allow_other_head=True)


def test_a_name_that_is_not_shipped_is_refused_with_those_that_are():
    with pytest.raises(ConfigurationError, match=r"bundle: expected .* the shipped .*'nonsense'"):
        make_controller("learned-gain", load_head("simulated"), bundle="nonsense")
    with pytest.raises(ConfigurationError, match=r"bundle: expected a file's path .* got 5"):
        make_controller("learned-gain", load_head("simulated"), bundle=5)


def test_a_copy_of_a_head_by_another_name_gets_the_network_of_that_head():
    copied = HEAD.replace(name="copied")
    assert make_controller("learned-gain", copied).manifest.head["name"] == "simulated"


def test_for_a_head_without_a_network_it_says_which_heads_have_one_and_how_to_learn_one():
    own = load_head("simulated").replace(name="own", limits={"upper": np.full(7, 0.7)})
    heads = load_scenario("hardware").model(), load_head("physical")
    simulated, physical = (head.digest[:12] for head in heads)
    with pytest.raises(ConfigurationError) as caught:
        make_controller("learned-policy", own)
    text = str(caught.value)
    assert f"head 'own' ({own.digest[:12]})" in text
    assert f"simulated ({simulated})" in text
    assert f"physical ({physical})" in text
    assert "vergence train policy --head" in text
    assert "\n" not in text


def test_only_a_bare_network_needs_onnxruntime(tmp_path, monkeypatch):
    path = onnx_file(tmp_path / "mine.onnx")
    for package in ("onnx", "onnxruntime", "torch"):
        monkeypatch.setitem(sys.modules, package, None)
    assert make_controller("learned-policy", HEAD).predict(observations((2,)))[0].any()
    with pytest.raises(ConfigurationError, match=r"pip install 'vergence\[learned\]'"):
        load_policy(path, HEAD)


def test_an_exported_network_is_what_onnxruntime_runs(bundles, tmp_path):
    import onnxruntime

    shipped = pretrained_bundles()
    for path in [*bundles.values(), *(shipped[f"{kind}-simulated"] for kind in KINDS)]:
        with named(path.stem):
            bundle = read_bundle(path)
            session = onnxruntime.InferenceSession(bundle_as_onnx(bundle))
            x = np.random.default_rng(0).uniform(-1, 1, (1000, bundle.network.input_size))
            (found,) = session.run(["actions"], {"inputs": x.astype("f4")})
            y = bundle.network(x.astype("f4"))
            expected = y**3 if bundle.manifest.kind == "policy" else ((1 + y) / 2) ** 2
            assert found == pytest.approx(expected, abs=5e-6)
            metadata = session.get_modelmeta().custom_metadata_map["manifest"]
            assert json.loads(metadata)["head"] == bundle.manifest.head


def test_periods_in_which_the_linear_law_acted_are_counted():
    controller = make_controller("learned-policy", HEAD)
    seen = observations((3,))
    _action, state = controller.predict(seen)
    assert controller.linear_periods(state).tolist() == [0, 0, 0]
    calm = controller._loop._calm
    controller._loop._calm = lambda now: np.where([[False], [True], [True]], 0.0, calm(now))
    _action, state = controller.predict(seen, state)
    assert controller.linear_periods(state).tolist() == [0, 1, 1]


# What ships.


def test_the_head_of_a_scenario_gets_the_network_of_its_name():
    for scenario, kind in some_of(["hardware", "workspace", "physical", "webcam"], list(KINDS)):
        with named(scenario, kind):
            head = load_scenario(scenario).model()
            controller = make_controller(NAMES[kind], head)
            assert controller.manifest.head["name"] == head.name
            assert controller.manifest.kind == kind


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_the_shipped_networks_settle_in_a_robots_loop(kind):
    """In 2 px; not in every trial, as chance has a part in what a network learns."""
    scenario = load_scenario("hardware")
    controller = make_controller(NAMES[kind], scenario.model())
    settle_s = run_trials(controller, scenario, episodes=20, split="validation").settle_s(2.0)
    assert np.isfinite(settle_s).mean() >= 0.95
    assert np.nanmedian(settle_s) < 0.7


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_the_shipped_networks_are_calm_on_servos_that_overshoot(kind):
    scenario = with_imperfection(load_scenario("hardware"), "overshoot", 0.3)
    controller = make_controller(NAMES[kind], scenario.model())
    trials = run_trials(controller, scenario, episodes=16, split="validation")
    assert not trials.swings.any()
    assert np.isfinite(trials.settle_s(2.0)).all()


def test_the_shipped_bundles_are_small_and_say_how_they_were_made():
    for kind in KINDS:
        with named(kind):
            shipped = pretrained_bundles()
            assert f"{kind}-simulated" in shipped
            for path in (path for name, path in shipped.items() if name.startswith(kind)):
                assert path.stat().st_size < 1_000_000
                training = read_bundle(path).manifest.training
                assert training["command"].startswith(f"vergence train {kind} ")
                assert f"--seed {training['seed']}" in training["command"]


# Nothing on the way from a file to an action can execute what the file says.

FORBIDDEN_MODULES = {"pickle", "cloudpickle", "dill", "marshal", "shelve", "torch", "joblib"}
FORBIDDEN_CALLS = {"eval", "exec", "compile", "__import__"}


def executing(source: str) -> list[str]:
    """Imports and calls of a module that could execute bytes as code."""
    found = []
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            found += [a.name for a in node.names if a.name.split(".")[0] in FORBIDDEN_MODULES]
        elif isinstance(node, ast.ImportFrom):
            if (node.module or "").split(".")[0] in FORBIDDEN_MODULES:
                found.append(str(node.module))
        elif isinstance(node, ast.Call):
            owner, attribute = getattr(node.func, "value", None), getattr(node.func, "attr", "")
            name = getattr(node.func, "id", f"{getattr(owner, 'id', '')}.{attribute}")
            if name in FORBIDDEN_CALLS or name.endswith((".load_module", "np.load", "read_pickle")):
                found.append(name)
    return found


def test_no_load_path_of_a_controller_unpickles_or_evaluates():
    folders = ("controllers", "hardware", "eval/comparison", "eval/trials")
    paths = [path for folder in folders for path in PACKAGE.glob(f"{folder}/**/*.py")]
    paths += [PACKAGE / "commands" / f"{name}.py" for name in ("evaluate", "deploy")]
    assert {"learned.py", "contestants.py", "evaluate.py"} <= {path.name for path in paths}
    words = re.compile(
        rf"\b({'|'.join(FORBIDDEN_MODULES)})\b|\b({'|'.join(FORBIDDEN_CALLS)})\(|load|read_"
    )
    sources = {path.name: path.read_text("utf-8") for path in paths}
    faults = {name: executing(text) for name, text in sources.items() if words.search(text)}
    assert {name: fault for name, fault in faults.items() if fault} == {}
    for source in ["import pickle", "from torch import load", "eval('1')", "np.load('x')"]:
        with named(source):
            assert executing(source)
