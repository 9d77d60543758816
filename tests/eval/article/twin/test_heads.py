"""The population of true heads: what its errors do to them."""

import dataclasses

import numpy as np
import pytest

from vergence.errors import ConfigurationError
from vergence.eval.article.twin.heads import TwinConfig, draw_heads, with_common_tilt
from vergence.eval.trials.twin_errors import TWIN_SPREADS
from vergence.models.perturbation import ModelErrors


def test_a_common_tilt_leaves_the_cameras_as_they_were_to_each_other(nominal):
    q = nominal.fixate((-0.4, -0.2, 1.0))
    tilted = with_common_tilt(nominal[None], np.array([0.03]))[0]
    before, after = nominal.camera_poses(q), tilted.camera_poses(q)
    assert np.allclose(np.linalg.inv(before[0]) @ before[1], np.linalg.inv(after[0]) @ after[1])
    # both eyes look lower: y is down
    assert (after[:, 1, 2] > before[:, 1, 2] + 0.02).all()


def test_one_source_alone_deviates_as_it_does_among_all(nominal):
    both = draw_heads(nominal, TWIN_SPREADS, 12, 3)
    alone = draw_heads(nominal, ModelErrors(principal_px=TWIN_SPREADS.principal_px), 12, 3)
    assert np.array_equal(both.cameras.principal, alone.cameras.principal)
    assert np.array_equal(alone.head_eye[0], nominal.head_eye)
    assert np.array_equal(np.broadcast_to(nominal.links.offset, (12, 9)), alone.links.offset)


def test_the_rest_of_a_head_is_the_same_without_a_common_tilt(nominal):
    tilted = draw_heads(nominal, TWIN_SPREADS, 12, 3)
    upright = draw_heads(nominal, dataclasses.replace(TWIN_SPREADS, common_tilt_rad=0.0), 12, 3)
    assert np.array_equal(tilted.head_eye, upright.head_eye)
    assert np.array_equal(tilted.links.d, upright.links.d)
    apart = tilted.links.offset - upright.links.offset
    moved = np.abs(apart).max(axis=0) > 0.0
    assert moved.sum() == 2
    assert np.allclose(apart.sum(axis=1), 0.0)


def test_deviations_are_proportional_to_the_errors(nominal):
    heads = [draw_heads(nominal, TWIN_SPREADS.scaled(f), 12, 3) for f in (0.5, 1.0)]
    once, twice = (one.links.offset - nominal.links.offset for one in heads)
    assert np.allclose(2.0 * once, twice)


def test_a_population_of_none_is_refused(nominal):
    with pytest.raises(ConfigurationError, match="heads: expected at least 1, got 0"):
        draw_heads(nominal, TwinConfig().errors, 0, 0)
