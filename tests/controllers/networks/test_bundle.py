"""Bundles: what is written is read back, and everything else is refused with the reason."""

import dataclasses
import hashlib
import io
import json
import zipfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.controllers.networks.graphs import KINDS, TRAINING, bundle_of, perceptron
from tests.naming import named
from vergence import load_head
from vergence.controllers.networks.bundle import (
    MAX_BUNDLE_BYTES,
    parse_bundle,
    read_bundle,
    write_bundle,
)
from vergence.controllers.networks.inputs import Inputs
from vergence.controllers.networks.manifest import Manifest, sensorless_digest
from vergence.envs.observation import ObservationLayout
from vergence.errors import BundleError
from vergence.eval.trials.scenarios import load_scenario
from vergence.models import ModelErrors
from vergence.models.parts import JOINTS


@pytest.fixture(scope="module")
def path(tmp_path_factory) -> Path:
    return bundle_of(tmp_path_factory.mktemp("bundles"))


@pytest.fixture(scope="module")
def parts(path) -> dict[str, bytes]:
    with zipfile.ZipFile(path) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def packed(
    entries: list[tuple[str, bytes]], comment: bytes | None = None, method: int = 8
) -> bytes:
    """A zip with the comment that belongs to its manifest, or another."""
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", method) as archive:
        for name, content in entries:
            archive.writestr(name, content)
        manifest = dict(entries).get("manifest.json", b"")
        own = hashlib.sha256(manifest).hexdigest().encode()
        archive.comment = own if comment is None else comment
    return file.getvalue()


def changed(parts: dict[str, bytes], fields: dict[str, object]) -> bytes:
    """The bundle with other values in its manifest, and hashes that fit."""
    content = {**json.loads(parts["manifest.json"]), **fields}
    return packed([("manifest.json", json.dumps(content).encode()), *list(parts.items())[1:]])


def test_what_is_written_is_read_back(tmp_path):
    for kind in KINDS:
        with named(kind):
            inputs = Inputs.of(KINDS[kind], load_head("simulated"))
            network = perceptron(inputs.size)
            manifest = Manifest.of(kind, inputs, network, TRAINING, {"settle_s": 0.25})
            write_bundle(tmp_path / f"{kind}.vgp", manifest, network)
            bundle = read_bundle(tmp_path / f"{kind}.vgp")
            assert bundle.manifest == manifest
            assert bundle.network.data == network
            assert bundle.network.input_size == inputs.size


def test_the_manifest_says_all_that_is_needed_to_run_it(parts):
    head = load_head("simulated")
    content = json.loads(parts["manifest.json"])
    assert (content["format"], content["version"]) == ("vergence-bundle", 1)
    fits = sensorless_digest(load_scenario("hardware").model())
    assert content["head"] == {"name": "simulated", "digest": head.digest, "fits": fits}
    assert content["joints"] == list(JOINTS)
    assert content["period_s"] == head.timing.period_s
    assert content["layout"] == ObservationLayout.of(head).to_dict()
    assert content["inputs"] == Inputs.of("to_go", head).to_dict()
    assert content["actions"] == {
        "names": ["left_tilt", "left_pan", "right_tilt", "right_pan"], "unit": "rad/s",
        "low": [-6.0] * 4, "high": [6.0] * 4,
    }  # fmt: skip
    assert content["training"] == TRAINING
    digest = hashlib.sha256(parts["policy.onnx"]).hexdigest()
    part = {"sha256": digest, "size": len(parts["policy.onnx"])}
    assert content["parts"] == {"policy.onnx": part}


def test_the_outputs_of_a_gain_schedule_are_gains(tmp_path):
    manifest = read_bundle(bundle_of(tmp_path, "gain-schedule")).manifest
    assert manifest.actions == {
        "names": ["left_v", "left_u", "right_v", "right_u"], "unit": "1/s", "low": [0.0] * 4,
        "high": [20.0] * 4,
    }  # fmt: skip


def test_a_stored_bundle_is_read_as_a_deflated_one(path, parts):
    stored = parse_bundle(packed(list(parts.items()), method=zipfile.ZIP_STORED), "stored")
    assert stored.manifest == read_bundle(path).manifest


def test_a_file_is_replaced_only_when_asked_for(path, tmp_path):
    bundle, kept = read_bundle(path), tmp_path / "kept.vgp"
    assert bundle_of(tmp_path / "again").read_bytes() == path.read_bytes()
    kept.write_text("mine")
    with pytest.raises(BundleError, match="expected no file of that name"):
        write_bundle(kept, bundle.manifest, bundle.network.data)
    assert kept.read_text() == "mine"
    write_bundle(kept, bundle.manifest, bundle.network.data, replace=True)
    assert read_bundle(kept).manifest == bundle.manifest
    assert {p.name for p in tmp_path.iterdir()} == {"again", "kept.vgp"}


def test_what_would_be_refused_is_not_written(path, tmp_path):
    bundle = read_bundle(path)
    with pytest.raises(BundleError, match=r"policy.onnx: expected SHA-256"):
        write_bundle(tmp_path / "a.vgp", bundle.manifest, perceptron(seed=1))
    nan = dataclasses.replace(bundle.manifest, metrics={"settle_s": np.nan})
    with pytest.raises(BundleError, match="plain finite values"):
        write_bundle(tmp_path / "a.vgp", nan, bundle.network.data)
    assert not list(tmp_path.iterdir())


# The zip.


def refused(data: bytes, match: str) -> None:
    with pytest.raises(BundleError, match=match) as caught:
        parse_bundle(data, "some.vgp")
    assert str(caught.value).startswith("some.vgp: ")
    assert "\n" not in str(caught.value)


def test_a_changed_manifest_is_refused_by_its_hash(parts):
    other = parts["manifest.json"].replace(b'"seed": 3', b'"seed": 4')
    digest = hashlib.sha256(parts["manifest.json"]).hexdigest()
    entries = [("manifest.json", other), ("policy.onnx", parts["policy.onnx"])]
    refused(packed(entries, digest.encode()), "manifest.json .*expected SHA-256")
    refused(packed(entries, b""), "manifest.json .*expected a SHA-256, got none")


def test_a_changed_network_is_refused_by_its_hash(parts):
    other = perceptron(Inputs.of("to_go", load_head("simulated")).size, seed=1)
    assert len(other) == len(parts["policy.onnx"])
    entries = [*list(parts.items())[:1], ("policy.onnx", other)]
    refused(packed(entries), "policy.onnx: expected SHA-256")


def test_a_wrong_size_in_the_manifest_is_refused(parts):
    stated = json.loads(parts["manifest.json"])["parts"]
    stated["policy.onnx"]["size"] += 1
    refused(changed(parts, {"parts": stated}), "policy.onnx: expected .*size")


@pytest.mark.filterwarnings("ignore:Duplicate name")
def test_other_entries_are_refused(parts):
    items = list(parts.items())
    refused(packed(items[:1]), "expected the entries manifest.json, policy.onnx, got")
    refused(packed([*items, ("readme.txt", b"hello")]), "readme.txt")
    refused(packed([*items, ("../../etc/cron.d/evil", b"")]), "etc/cron.d/evil")
    refused(packed([*items, items[1]]), r"got \['manifest.json', 'policy.onnx', 'policy.onnx'\]")


def test_another_compression_is_refused(parts):
    refused(packed(list(parts.items()), method=zipfile.ZIP_BZIP2), "stored or deflated")


@pytest.mark.slow
def test_a_bomb_is_refused_whether_its_size_is_announced_or_not(parts):
    bomb = packed([("manifest.json", parts["manifest.json"]), ("policy.onnx", bytes(2**26))])
    assert len(bomb) < 2**17
    refused(bomb, "expected at most 4194304 bytes, got 67108864 announced")
    lie = bomb.replace((2**26).to_bytes(4, "little"), (1000).to_bytes(4, "little"))
    refused(lie, "1000 bytes with their checksum|damage")


def test_too_large_a_file_is_refused_before_it_is_read(tmp_path):
    refused(bytes(MAX_BUNDLE_BYTES + 1), "expected at most 4194304 bytes, got 4194305")
    large = tmp_path / "large.vgp"
    with large.open("wb") as file:
        file.truncate(2**40)  # takes no room on the disk
    with pytest.raises(BundleError, match="expected at most 4194304 bytes, got more"):
        read_bundle(large)


def test_what_is_no_file_is_refused(tmp_path):
    for path in (tmp_path, tmp_path / "missing.vgp", "/dev/zero"):
        with pytest.raises(BundleError, match="expected a file"):
            read_bundle(path)


# Damage: refused, or harmless; never another exception, which would be a BundleError's absence.


@pytest.mark.slow
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=100)
@given(data=st.data())
def test_flipped_bytes_are_refused_or_change_nothing(path, data):
    good = path.read_bytes()
    bad = bytearray(good)
    for _ in range(data.draw(st.integers(1, 3))):
        bad[data.draw(st.integers(0, len(bad) - 1))] ^= data.draw(st.integers(1, 255))
    try:
        bundle = parse_bundle(bytes(bad), "flipped")
    except BundleError:
        return
    assert bundle.manifest == parse_bundle(good, "good").manifest
    assert bundle.network.data == parse_bundle(good, "good").network.data


def test_a_truncated_file_is_refused(path):
    data = path.read_bytes()
    for length in [0, 1, *range(40, len(data), 300), len(data) - 1]:
        with named(length), pytest.raises(BundleError):
            parse_bundle(data[:length], "truncated")


# The manifest.


def test_another_manifest_is_refused(parts):
    for fields, match in [
        ({"format": "other"}, "format: expected 'vergence-bundle', got 'other'"),
        ({"version": 2}, "version: expected 1, got 2"),
        ({"run": "rm -rf /"}, r"also \['run'\]"),
        ({"layout": []}, "layout: expected a table, got"),
        ({"period_s": "soon"}, "period_s: expected a number with a point, got 'soon'"),
        ({"parts": {}}, "parts: expected policy.onnx alone"),
        ({"parts": {"policy.onnx": "x", "../evil": {}}}, "parts: expected policy.onnx alone"),
        ({"metrics": {"settle_s": np.nan}}, "NaN"),
    ]:
        with named(fields, match):
            refused(changed(parts, fields), match)


def test_what_is_no_manifest_is_refused(parts):
    for text in (b"", b"[]", b"[" * 100_000, b'{"kind": 1, "kind": 2}', b"\xff", b'{"version": 1}'):
        with named(text):
            refused(packed([("manifest.json", text), *list(parts.items())[1:]]), "manifest: ")


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
        ("actions", {"high": [60.0] * 4}, r"actions.high\[0\]: expected 6.0 .* got 60.0"),
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
