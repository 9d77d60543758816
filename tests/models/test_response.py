"""The light that grey levels stand for."""

import numpy as np
import pytest

from tests.naming import named
from vergence.errors import ConfigurationError
from vergence.models.camera import light_table, parse_response


def test_a_table_holds_the_light_at_levels_in_equal_steps():
    levels = np.arange(256)
    np.testing.assert_allclose(light_table("linear"), levels)
    np.testing.assert_allclose(light_table(2.0), 255.0 * (levels / 255.0) ** 2)
    light = light_table(parse_response([0.0, 0.2, 1.0]))
    assert np.interp(127.5, levels, light) == pytest.approx(0.2 * 255.0, rel=1e-2)
    # half of the light is level 187.5, a fifth of all levels 3.3 % (IEC 61966-2-1)
    light = light_table("srgb") / 255.0
    assert np.interp(0.5, light, levels) == pytest.approx(187.5, abs=0.1)
    assert light[51] == pytest.approx(0.0331, abs=1e-4)


def test_what_names_a_response_and_what_is_none():
    for text, response in [
        ("srgb", "srgb"), ("2.2", 2.2), (1, "linear"), ([0, 1], (0.0, 1.0)),
        ("0,0.2, 1", (0.0, 0.2, 1.0)),
    ]:  # fmt: skip
        with named(text, response):
            assert parse_response(text) == response
    said = "response: expected 'linear', 'srgb', a gamma"
    for value in (
        "sRGB!", "0,x,1", 0.0, -2.2, np.nan, True, None, [0.0, 0.5], [0.0, 0.6, 0.5, 1.0], [1.0],
    ):  # fmt: skip
        with named(value), pytest.raises(ConfigurationError, match=said):
            parse_response(value)
