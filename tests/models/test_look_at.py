"""Looking at a place by the head's model."""

import numpy as np
import pytest

from vergence import look_at
from vergence.calibration.head.calibrate import calibrate_head
from vergence.calibration.head.report import head_file_text
from vergence.calibration.head.simulated import simulate_recording
from vergence.errors import ConfigurationError
from vergence.eval.trials.twin_errors import TWIN_SPREADS
from vergence.models.head_file import load_head, parse_head


def test_the_angles_put_the_place_on_both_optical_axes():
    head, place = load_head("simulated"), [0.1, -0.05, 0.8]
    looked = look_at(head, place, neck=[0.1, 0.0, 0.05])
    assert np.allclose(looked.positions[:3], [0.1, 0.0, 0.05])
    assert np.allclose(head.project(looked.positions, place), head.cameras.principal, atol=1e-6)
    assert np.isnan(looked.sigma_px).all()
    assert "uncalibrated" in str(looked)


@pytest.mark.parametrize(
    ("place", "expected"),
    [([0.0, 0.0, -1.0], "both eyes can fixate"), ([5.0, 0.0, 0.1], "degrees, outside")],
)
def test_a_place_that_cannot_be_looked_at_is_refused(place, expected):
    with pytest.raises(ConfigurationError, match=expected):
        look_at(load_head("simulated"), place)


@pytest.mark.slow
def test_a_calibrated_head_is_off_as_it_expects():
    nominal, rng = load_head("physical"), np.random.default_rng(3)
    true = nominal.perturbed(rng, TWIN_SPREADS)
    found = calibrate_head(nominal, simulate_recording(nominal, true, rng).frames)
    head = parse_head(head_file_text(found, "0" * 64, "calibrated"))
    squares = []
    for place in rng.uniform([-0.3, -0.3, 0.4], [0.3, 0.3, 2.5], (60, 3)):
        looked = look_at(head, place)
        q = looked.positions.copy()
        q[3:] += head.sensor.encoder_resolution_rad * rng.uniform(-0.5, 0.5, 4)
        off = true.project(q, place) - true.cameras.principal
        squares.append((off / looked.sigma_px) ** 2)
    assert 0.7 < np.mean(squares) < 2.0
