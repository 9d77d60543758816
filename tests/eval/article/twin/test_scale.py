"""The scalar that makes the median head's largest depth error the article's."""

import numpy as np
import pytest

from vergence.errors import ConfigurationError
from vergence.eval.article.reported import static_points
from vergence.eval.article.twin.fixation_errors import settled_fix_errors_m
from vergence.eval.article.twin.heads import TwinConfig, draw_heads
from vergence.eval.article.twin.scale import find_error_scale, largest_depth_error_percent

POINTS = static_points("physical")


@pytest.mark.nightly
def test_the_scale_makes_the_median_head_the_article_s(nominal):
    config = TwinConfig(heads=30)
    scale = find_error_scale(nominal, config, 1)
    errors = settled_fix_errors_m(
        nominal, draw_heads(nominal, config.errors.scaled(scale), 30, 1), POINTS
    )
    # the encoders' steps make the median jump by some tenths of a per cent of 30 heads
    assert np.median(largest_depth_error_percent(errors, POINTS)) == pytest.approx(4.97, abs=0.15)


def test_a_scale_of_the_user_s_is_taken(nominal):
    assert find_error_scale(nominal, TwinConfig(scale=0.3), 0) == 0.3


def test_less_than_the_encoders_give_is_refused(nominal):
    with pytest.raises(ConfigurationError, match="encoders alone"):
        find_error_scale(nominal, TwinConfig(heads=3, largest_error_percent=0.1), 0)
