"""The law on the present error turns to the end also where commands go out in steps."""

import numpy as np
import pytest

from vergence.controllers.controller import make_controller
from vergence.controllers.tuned import (
    find_tuned_or_fallback,
    is_tuned_for,
    tuned_or_fallback_options,
)
from vergence.eval.trials.run import run_trials
from vergence.eval.trials.scenarios import load_scenario

TICKED = ("hardware", "webcam")


@pytest.mark.parametrize("scenario", TICKED)
def test_it_settles_on_heads_whose_speeds_come_in_ticks(scenario: str) -> None:
    loaded = load_scenario(scenario)
    head = loaded.model()
    assert head.sensor.command_resolution_rad_s > 0.0
    assert is_tuned_for(find_tuned_or_fallback("delay-compensated", scenario, head), head)
    options = tuned_or_fallback_options("delay-compensated", scenario, head)
    trials = run_trials(make_controller("delay-compensated", head, **options), loaded, episodes=20)
    # without what steps leave being carried on, half of them stop short of the band
    assert np.isfinite(trials.settle_s(2.0)).mean() >= 0.95
