"""The record of a calibration in a head's file: kept as it is, no part of the head's numbers."""

import tomllib
from dataclasses import replace

import pytest
import tomli_w

from tests.heads import head_of
from tests.naming import named
from vergence.errors import HeadFileError
from vergence.models import load_head, parse_head, save_head
from vergence.models.head_file import head_to_toml
from vergence.models.parts import CalibrationRecord

RECORD = CalibrationRecord(
    target="checkerboard:9x6:24", views=24, rms_px=0.15, rms_heldout_px=0.16,
    corners_sha256="0123456789abcdef" * 4, versions="vergence 0.1.0, numpy 2.0.0",
    sigma={"left.camera.f_u": 0.8, "right.head_eye.x": 0.0001},
)  # fmt: skip


@pytest.fixture
def calibrated(physical):
    return replace(physical, calibration=RECORD)


def test_a_file_gives_it_back(calibrated, tmp_path):
    for head in (calibrated, replace(head_of("pair"), calibration=RECORD)):
        save_head(head, tmp_path / "head.toml")
        again = load_head(tmp_path / "head.toml")
        assert again == head
        assert again.calibration == RECORD
        assert head_to_toml(again) == head_to_toml(head)


def test_it_is_of_one_geometry_and_no_part_of_the_digest(calibrated, simulated, rng, errors):
    assert simulated.calibration is None
    assert "calibration" not in tomllib.loads(head_to_toml(simulated))
    assert replace(calibrated, calibration=None).digest == calibrated.digest
    drawn = calibrated.perturbed(rng, errors, 3)
    assert (drawn.calibration, drawn[1].calibration) == (None, None)
    assert calibrated.with_parameters(calibrated.parameters().values).calibration is None
    assert calibrated.calibration == RECORD
    assert calibrated.replace(timing={"lag_s": 0.0}).calibration == RECORD
    assert calibrated.replace(cameras={"focal": calibrated.cameras.focal + 1.0}).calibration is None


def test_what_cannot_be_one_is_refused_by_its_key():
    for key, value, said in [
        ("target", 9, r"calibration\.target: expected the board, such as 'checkerboard:9x6:24'"),
        ("views", 24.5, r"calibration\.views: expected a whole number, 0 to 10000, got 24\.5"),
        ("rms_px", -0.1, r"calibration\.rms_px: expected a number of at least 0, got -0\.1"),
        ("rms_heldout_px", float("nan"), r"calibration\.rms_heldout_px: expected a number"),
        ("corners_sha256", "12ab", r"calibration\.corners_sha256: expected 64 hexadecimal digits"),
        ("versions", "", r"calibration\.versions: expected names and versions of programs"),
        ("sigma", 1.0, r"calibration\.sigma: expected a table, got 1\.0"),
        ("sigma", {"left.camera.f_u": -1.0}, r"sigma\.left\.camera\.f_u: expected a number of at"),
        ("rms", 0.1, r"calibration\.rms: expected no such key \(is calibration\.rms_px meant\?\)"),
        ("views", None, r"calibration\.views: expected a whole number.*the key is missing"),
    ]:
        with named(key, value, said):
            content = tomllib.loads(head_to_toml(replace(head_of("pair"), calibration=RECORD)))
            if value is None:
                del content["calibration"][key]
            else:
                content["calibration"][key] = value
            with pytest.raises(HeadFileError, match=said):
                parse_head(tomli_w.dumps(content))
