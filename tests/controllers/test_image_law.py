"""The gate and the steps around a law: nothing on an ideal loop, all the difference on a robot."""

import numpy as np
import pytest

from vergence import make_controller
from vergence.eval.trials.run import run_trials
from vergence.eval.trials.scenarios import load_scenario

LAWS = {
    "ibvs-tuned": {"gain": 3.0},
    "adaptive": {"lambda_zero": 3.0, "lambda_inf": 3.0},
    "pid": {"kp": 3.0, "ki": 0.0, "kd": 0.0},
    "fuzzy": {"kp": 3.0, "ki": 0.0, "kd": 0.0, "span_p": 0.0},
}
"""Options with which each is the article's law with a gain of 3."""


def trials(name, scenario, **options):
    scenario = load_scenario(scenario)
    controller = make_controller(name, scenario.model(), **options)
    return run_trials(controller, scenario, episodes=16, split="validation")


@pytest.mark.parametrize("name", ["adaptive", "pid"])
def test_where_there_is_no_fault_each_is_the_law_alone(name) -> None:
    alone = trials("ibvs", "workspace", gain=3.0)
    assert trials(name, "workspace", **LAWS[name]).error == pytest.approx(alone.error, abs=1e-3)


@pytest.mark.parametrize("name", ["ibvs-tuned", "fuzzy"])
def test_through_a_robots_loop_each_settles_where_the_law_alone_does_not(name) -> None:
    alone = np.isfinite(trials("ibvs", "hardware", gain=3.0).settle_s(2.0)).mean()
    guarded = np.isfinite(trials(name, "hardware", **LAWS[name]).settle_s(2.0)).mean()
    assert alone < 0.2
    assert guarded > 0.9
