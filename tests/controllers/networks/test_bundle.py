"""Bundles: what is written is read back, and everything else is refused with the reason."""

import dataclasses
import json
import zipfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from safetensors.numpy import load_file, save, save_file

from tests.controllers.networks.graphs import KINDS, TRAINING, bundle_of, perceptron
from tests.naming import named
from vergence import load_head
from vergence.controllers.networks.bundle import (
    MAX_FILE_BYTES,
    Manifest,
    Perceptron,
    _digest,
    read_bundle,
    sensorless_digest,
    write_bundle,
)
from vergence.controllers.networks.inputs import Inputs
from vergence.envs.observation import ObservationLayout
from vergence.errors import BundleError
from vergence.eval.trials.scenarios import load_scenario
from vergence.models import ModelErrors
from vergence.models.parts import JOINTS


@pytest.fixture(scope="module")
def path(tmp_path_factory) -> Path:
    return bundle_of(tmp_path_factory.mktemp("bundles"))


def manifest_of(path: Path) -> dict:
    """The manifest as anybody's reader of safetensors finds it."""
    size = int.from_bytes(path.read_bytes()[:8], "little")
    return json.loads(json.loads(path.read_bytes()[8 : 8 + size])["__metadata__"]["manifest"])


def test_what_is_written_is_read_back(tmp_path):
    rng = np.random.default_rng(0)
    normalisation = rng.normal(size=76), rng.uniform(1, 2, 76), 10.0
    for kind, options in (
        ("gain-schedule", {"joints": 4}),
        ("policy", {"activation": "silu", "normalisation": normalisation}),
    ):
        with named(kind):
            inputs = Inputs(KINDS[kind], load_head("simulated"))
            network = perceptron(inputs.size, **options)
            manifest = Manifest.of(kind, inputs, network, TRAINING, {"settle_s": 0.25})
            write_bundle(tmp_path / f"{kind}.vgp", manifest, network)
            bundle = read_bundle(tmp_path / f"{kind}.vgp")
            assert bundle.manifest == manifest
            x = rng.uniform(-1, 1, (5, inputs.size)).astype("f4")
            assert np.array_equal(bundle.network(x), network(x))


def test_the_manifest_says_all_that_is_needed_to_run_it(path):
    head = load_head("simulated")
    content = manifest_of(path)
    assert (content["format"], content["version"]) == ("vergence-bundle", 2)
    fits = sensorless_digest(load_scenario("hardware").model())
    assert content["head"] == {"name": "simulated", "digest": head.digest, "fits": fits}
    assert content["joints"] == list(JOINTS)
    assert content["period_s"] == head.timing.period_s
    assert content["layout"] == ObservationLayout.of(head).to_dict()
    assert content["inputs"] == Inputs("to_go", head).to_dict()
    assert content["actions"] == {
        "names": ["left_tilt", "left_pan", "right_tilt", "right_pan"], "unit": "rad/s",
        "limit": [6.0] * 4, "value": "limit y^3",
    }  # fmt: skip
    assert content["network"] == {"activation": "tanh", "joints": 1, "clip_inputs": None}
    assert content["training"] == TRAINING


def test_the_outputs_of_a_gain_schedule_are_gains(tmp_path):
    manifest = read_bundle(bundle_of(tmp_path, "gain-schedule")).manifest
    assert manifest.actions == {
        "names": ["left_v", "left_u", "right_v", "right_u"], "unit": "1/s", "limit": [20.0] * 4,
        "value": "limit ((1 + y) / 2)^2",
    }  # fmt: skip


def test_a_file_is_replaced_only_when_asked_for(path, tmp_path):
    bundle, kept = read_bundle(path), tmp_path / "kept.vgp"
    assert bundle_of(tmp_path / "again").read_bytes() == path.read_bytes()
    kept.write_text("mine")
    with pytest.raises(BundleError, match="expected no file of that name"):
        write_bundle(kept, bundle.manifest, bundle.network)
    assert kept.read_text() == "mine"
    write_bundle(kept, bundle.manifest, bundle.network, replace=True)
    assert read_bundle(kept).manifest == bundle.manifest
    assert {p.name for p in tmp_path.iterdir()} == {"again", "kept.vgp"}


def test_what_would_be_refused_is_not_written(path, tmp_path):
    bundle = read_bundle(path)
    weights, bias = bundle.network.layers[0]
    endless = Perceptron(layers=((weights * np.inf, bias),), activation="tanh")
    with pytest.raises(BundleError, match=r"layers.0.weight: expected finite numbers"):
        write_bundle(tmp_path / "a.vgp", bundle.manifest, endless)
    nan = dataclasses.replace(bundle.manifest, metrics={"settle_s": np.nan})
    with pytest.raises(BundleError, match="plain finite values"):
        write_bundle(tmp_path / "a.vgp", nan, bundle.network)
    assert not list(tmp_path.iterdir())


# The network.


def test_each_activation_is_its_function():
    x = np.concatenate([np.linspace(-12, 12, 4001), [-1e30, 1e30]]).astype("f4")[:, None]
    eye = (np.ones((1, 1), "f4"), np.full(1, 0.25, "f4"))
    scale = (np.full((1, 1), 0.05, "f4"), np.zeros(1, "f4"))
    z = x.astype(np.float64) + 0.25
    with np.errstate(over="ignore"):
        functions = {
            "tanh": np.tanh(z),
            "relu": np.maximum(z, 0.0),
            "elu": np.where(z > 0.0, z, np.expm1(z)),
            "silu": z / (1.0 + np.exp(-z)),
        }
    for name, expected in functions.items():
        with named(name):
            found = Perceptron(layers=(eye, scale), activation=name)(x)
            assert found == pytest.approx(np.clip(0.05 * expected, -1, 1), abs=1e-7)


def test_a_network_for_each_joint_is_the_dense_one_with_its_weights_in_blocks():
    network = perceptron(12, joints=4)
    dense = []
    for k, (weights, bias) in enumerate(network.layers):
        rows, columns = weights.shape
        wide = np.zeros((4 * rows, 4 * columns), "f4")
        for j in range(4):
            own = slice(j, None, 4) if k == 0 else slice(j * columns, (j + 1) * columns)
            wide[j * rows : (j + 1) * rows, own] = weights
        dense.append((wide, np.tile(bias, 4)))
    x = np.random.default_rng(1).uniform(-1, 1, (600, 12)).astype("f4")
    expected = Perceptron(layers=tuple(dense), activation="tanh")(x)
    assert network(x) == pytest.approx(expected, abs=1e-6)
    assert network(x[7]) == pytest.approx(expected[7], abs=1e-6)


# The file.


def refused(path: Path, match: str) -> None:
    with pytest.raises(BundleError, match=match) as caught:
        read_bundle(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert "\n" not in str(caught.value)


def test_what_is_no_bundle_is_refused(tmp_path):
    for other in (tmp_path, tmp_path / "missing.vgp", "/dev/zero", f"{'x' * 5000}.vgp"):
        refused(other, "expected a file")
    other = tmp_path / "other.vgp"
    with other.open("wb") as file:
        file.truncate(2**40)  # takes no room on the disk
    refused(other, f"expected at most {MAX_FILE_BYTES} bytes, got 1099511627776")
    for data in (b"", b"import os", b"\xff" * 100):
        other.write_bytes(data)
        refused(other, "expected a safetensors file, got")
    with zipfile.ZipFile(other, "w") as archive:
        archive.writestr("policy.onnx", b"")
    refused(other, "earlier format: `vergence export bundle RUN` writes")
    save_file({"x": np.zeros(3)}, other)
    refused(other, "manifest: expected JSON")


def test_an_edited_file_is_refused(path, tmp_path):
    tensors, text = load_file(path), json.dumps(manifest_of(path))
    other = tmp_path / "other.vgp"
    save_file(tensors, other, {"manifest": text})
    read_bundle(other)
    save_file(tensors, other, {"manifest": text.replace('"seed": 3', '"seed": 4')})
    refused(other, "expected the content that its SHA-256 states, got damage or an edit")
    save_file(tensors | {"layers.0.bias": tensors["layers.0.bias"] + 1}, other, {"manifest": text})
    refused(other, "expected the content that its SHA-256 states")


@pytest.mark.slow
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=100)
@given(data=st.data())
def test_flipped_bytes_are_refused_or_change_nothing(path, data, tmp_path_factory):
    good = path.read_bytes()
    bad = bytearray(good)
    for _ in range(data.draw(st.integers(1, 3))):
        bad[data.draw(st.integers(0, len(bad) - 1))] ^= data.draw(st.integers(1, 255))
    flipped = tmp_path_factory.mktemp("flipped") / "flipped.vgp"
    flipped.write_bytes(bad)
    try:
        bundle = read_bundle(flipped)
    except BundleError:
        return
    assert bundle.manifest == read_bundle(path).manifest
    for name, tensor in read_bundle(path).network.tensors().items():
        assert np.array_equal(bundle.network.tensors()[name], tensor)


def test_a_truncated_file_is_refused(path, tmp_path):
    data, other = path.read_bytes(), tmp_path / "truncated.vgp"
    for length in [0, 1, *range(40, len(data), 300), len(data) - 1]:
        with named(length):
            other.write_bytes(data[:length])
            refused(other, "expected a safetensors file, got")


def test_another_manifest_is_refused(path, tmp_path):
    content, tensors, other = manifest_of(path), load_file(path), tmp_path / "other.vgp"
    content.pop("sha256")
    for fields, match in [
        ({"format": "other"}, "format: expected 'vergence-bundle', got 'other'"),
        ({"version": 1}, "version: expected 2, got 1"),
        ({"run": "rm -rf /"}, "expected the fields .*, run"),
        ({"layout": []}, "layout: expected a table, got"),
        ({"period_s": "soon"}, "period_s: expected a number with a point, got 'soon'"),
        ({"network": {}}, "activation"),
        ({"network": {"activation": "tanh", "joints": 9}}, "joints: expected 1 to 7, got 9"),
        ({"network": {"activation": "tanh", "joints": 1, "clip_inputs": 1.0}}, "inputs.mean"),
        ({"network": {"activation": "tanh", "joints": 1, "clip_inputs": "x"}}, "clip_inputs"),
        ({"network": {"activation": "tanh", "joints": 1, "clip_inputs": -1.0}}, "clip_inputs"),
        ({"network": {"activation": [], "joints": 1, "clip_inputs": None}}, "activation"),
    ]:
        with named(fields, match):
            changed = {**content, **fields}
            changed["sha256"] = _digest(changed, tensors)
            save_file(tensors, other, {"manifest": json.dumps(changed)})
            refused(other, match)
    for text in ("", "[]", "[" * 100_000, '{"kind": NaN}'):
        other.write_bytes(save(tensors, {"manifest": text}))
        refused(other, "manifest: ")


def test_tensors_that_do_not_fit_together_are_refused(path):
    settings = read_bundle(path).network.settings()
    tensors = load_file(path)
    for name, value, match in [
        ("layers.0.bias", np.zeros(3, "f4"), r"layers.0.bias: expected float32 of shape \(16,\)"),
        ("layers.1.weight", np.zeros((4, 3), "f4"), r"of shape \(4, 16\), got float32"),
        ("layers.1.weight", np.zeros((4, 16)), r"expected float32 .*, got float64"),
        ("more", np.zeros(3, "f4"), "expected the tensors .*, got .*more"),
    ]:
        with named(name, match), pytest.raises(BundleError, match=match):
            Perceptron.of({**tensors, name: value}, settings)


# What it was made for.


def fits(path: Path, head, layout=None, **options) -> None:
    layout = ObservationLayout.of(head) if layout is None else layout
    read_bundle(path).manifest.check_fits(head, layout, **options)


def test_another_head_is_refused_unless_allowed(path):
    errors = ModelErrors(joint_offset_rad=0.01)
    other = load_head("simulated").perturbed(np.random.default_rng(0), errors)
    with pytest.raises(BundleError, match=r"head: expected a bundle for simulated .*, got one for"):
        fits(path, other)
    fits(path, other, allow_other_head=True)


def test_another_layout_or_period_is_refused_even_where_another_head_is_allowed(path):
    head = load_head("simulated")
    wide = head.replace(limits={"velocity": np.full(7, 5.0)})
    with pytest.raises(BundleError, match=r"layout.scaling\[9\]: expected 5.5 .*, got 6.6"):
        fits(path, wide, allow_other_head=True)
    slow = head.replace(timing={"control_rate_hz": 60.0, "frame_rate_hz": 60.0})
    with pytest.raises(BundleError, match=r"period_s: expected 0.01666.* got 0.00833"):
        fits(path, slow, allow_other_head=True)
    with pytest.raises(BundleError, match="layout"):
        fits(path, load_head("physical"), allow_other_head=True)


def test_what_means_another_thing_is_refused(tmp_path, path):
    for field, change, match in [
        ("inputs", {"version": 99}, "inputs.version: expected .*, got 99"),
        ("inputs", {"kind": "nonsense"}, "inputs: expected one of .*'nonsense'"),
        ("inputs", {"names": ["x"]}, "inputs.names: expected"),
        ("actions", {"unit": "furlong"}, "actions.unit: expected 'rad/s' .* got 'furlong'"),
        ("actions", {"limit": [60.0] * 4}, r"actions.limit\[0\]: expected 6.0 .* got 60.0"),
        ("layout", {"extra": 1}, "layout.extra: expected None"),
    ]:
        with named(field, change, match):
            manifest = read_bundle(path).manifest
            other = bundle_of(tmp_path, **{field: {**getattr(manifest, field), **change}})
            with pytest.raises(BundleError, match=match):
                fits(other, load_head("simulated"))


def test_another_joint_order_or_kind_is_refused(tmp_path):
    with pytest.raises(BundleError, match=r"joints\[0\]: expected 'neck_yaw'"):
        fits(bundle_of(tmp_path, joints=list(reversed(JOINTS))), load_head("simulated"))
    manifest = read_bundle(bundle_of(tmp_path)).manifest
    other = dataclasses.replace(manifest, kind="oracle")
    with pytest.raises(BundleError, match="kind: expected gain-schedule or policy, got 'oracle'"):
        other.check_fits(load_head("simulated"), ObservationLayout.of(load_head("simulated")))
