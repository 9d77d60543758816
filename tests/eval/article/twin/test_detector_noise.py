"""Errors of a detector on drawn images."""

import numpy as np
import pytest

from vergence.eval.article.twin.detector_noise import DetectorNoise, measure_head_noise
from vergence.models.head_file import load_head


@pytest.mark.nightly
def test_a_detector_errs_by_hundredths_of_a_pixel_near_and_far():
    near, far = (
        measure_head_noise(
            load_head("physical"), np.array([0.0, 0.0, z]), 2, 30, np.random.default_rng(0)
        )
        for z in (0.6, 2.4)
    )
    for noise in (near, far):
        assert noise.sigma_px.min() > 0.003
        assert noise.sigma_px.max() < 0.06
        assert noise.bias_px.max() < 0.03


def test_noise_at_several_places_is_a_row_a_place_of_a_table():
    places = [DetectorNoise(np.full((2, 2), s), np.full((2, 2), 2.0 * s)) for s in (0.1, 0.2)]
    frame = DetectorNoise.stacked(places).table(np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 2.0]]))
    assert np.allclose(frame["truth_z_mm"], [1000.0, 2000.0])
    assert np.allclose(frame["sigma_px"], [0.1, 0.2])
    assert np.allclose(frame["bias_px"], [0.2, 0.4])
