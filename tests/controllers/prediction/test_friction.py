"""Rest of laws on joints with friction: the emulated robot in simulated time."""

import numpy as np
import pytest

from benchmarks.friction import BAND_PX, errors_px
from vergence.hardware.emulator.world import MotorOptions


@pytest.mark.parametrize("law", ["state-feedback", "saccade"])
@pytest.mark.slow
def test_a_law_comes_to_rest_on_joints_with_friction(law):
    error = errors_px(law, MotorOptions(friction=0.05), 2, "turrets")
    assert np.flatnonzero(error > BAND_PX)[-1] < 2.0 * 60.0
