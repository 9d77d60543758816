"""The inputs of a network that is to find everything out by itself."""

import numpy as np
import pytest

from tests.controllers.loops import begin
from tests.heads import head_of
from tests.naming import named
from vergence.controllers.networks.history import (
    MIN_REACH_BEYOND_LATENCY_S,
    STORED_IMAGES,
    STORED_MOMENTS,
)
from vergence.controllers.networks.inputs import Inputs
from vergence.envs.observation import AGE_S
from vergence.envs.task import GazeTask
from vergence.models import HeadModel, load_head

RATES = [(120.0, 120.0), (120.0, 30.0), (60.0, 50.0), (1000.0, 90.0)]
"""Pairs of control rate and frame rate, Hz."""


def head_at(control_hz: float, frames_hz: float) -> HeadModel:
    timing = {"control_rate_hz": control_hz, "frame_rate_hz": frames_hz}
    return load_head("simulated").replace(timing=timing)


class Loop:
    """Heads whose actuators turn, and what the inputs say in each period."""

    def __init__(self, head: HeadModel, steps: int, **options: object) -> None:
        task = begin(GazeTask(5, head=head, plant="kinematic", **options), 3)
        self.inputs = inputs = Inputs.of("history", head, task.layout)
        memory = np.tile(inputs.initial(), (5, 1))
        self.values, self.exposures, self.seen = [], [], []
        self.actions = np.random.default_rng(0).uniform(-0.1, 0.1, (steps, 5, task.layout.count))
        for action in self.actions:
            self.values.append(inputs.update(task.encoded, memory))
            self.exposures.append(task.reading.exposure_s.copy())
            self.seen.append(task.layout.decode(task.encoded))
            task.step(action)
        self.period_s = head.timing.period_s

    def channel(self, name: str) -> np.ndarray:
        """(steps, 5, m) one channel."""
        m = self.inputs.layout.count
        first = self.inputs.names.index(f"{name}_{self.inputs.layout.action_names[0]}")
        return np.array(self.values)[..., first : first + m]


def test_an_image_enters_once_whatever_the_rates() -> None:
    for rates in RATES:
        with named(rates):
            loop = Loop(head_at(*rates), round(0.5 * rates[0]))
            exposures = np.array(loop.exposures)
            come = np.isfinite(exposures)
            new = come.copy()
            new[1:] &= exposures[1:] != exposures[:-1]
            fresh = loop.channel("fresh")
            assert fresh.sum(axis=0) == pytest.approx(np.tile(new.sum(axis=0)[:, None], 4))
            # each is older than the next by the time between their exposures
            at = [np.unique(exposures[come[:, i], i])[-STORED_IMAGES:][::-1] for i in range(5)]
            ages = [loop.channel(f"age_{k}")[-1, :, 0] * AGE_S for k in range(STORED_IMAGES)]
            # images are dated to a period, and float32 rounds their age
            expected = ages[0] + at[0][0] - np.array(at).T
            assert np.array(ages) == pytest.approx(expected, abs=1.01 * loop.period_s)
            assert (np.diff(ages, axis=0) > 0.0).all()


def test_the_newest_image_is_that_of_the_observation_and_grows_older() -> None:
    loop = Loop(head_at(120.0, 30.0), 60)
    told = np.array([seen.image_age_s for seen in loop.seen])
    known = told < AGE_S
    age = loop.channel("age_0")[..., 0] * AGE_S
    assert age[known] == pytest.approx(told[known], abs=1e-5)


def test_how_far_it_has_turned_since_is_what_the_observation_says() -> None:
    loop = Loop(load_head("simulated"), 60)
    now = np.array([seen.positions[:, 3:] for seen in loop.seen])
    then = np.array([seen.positions_at_exposure[:, 3:] for seen in loop.seen])
    turned = np.clip((now - then) / 0.1, -1.0, 1.0)
    sees = loop.channel("seen_0") > 0.0
    assert sees.any()
    assert loop.channel("turned_middle_0")[sees] == pytest.approx(turned[sees], abs=1e-4)


@pytest.mark.slow
def test_commands_and_velocities_are_those_of_the_last_periods() -> None:
    loop = Loop(load_head("simulated"), 60)
    speeds = np.array([seen.velocities[:, 3:] for seen in loop.seen])
    limits = loop.inputs.layout.action_limits
    for k in range(STORED_MOMENTS):
        sent = loop.channel(f"command_{k}")[k + 1 :]
        assert sent == pytest.approx(loop.actions[: len(sent)], abs=1e-4)
        read = loop.channel(f"speed_{k}")[k:]
        assert read == pytest.approx(speeds[: len(read)] / limits, abs=1e-4)


def test_moments_reach_back_beyond_the_delay_of_an_image_at_any_rate() -> None:
    for rates in RATES:
        with named(rates):
            head = head_at(*rates)
            moment_s = Inputs.of("history", head)._history.moment_s
            reach_s = head.timing.latency_s + MIN_REACH_BEYOND_LATENCY_S
            assert moment_s * STORED_MOMENTS >= reach_s - 1e-9
            longest_s = (head.timing.latency_s + 0.1) / STORED_MOMENTS
            assert moment_s <= max(head.timing.period_s, longest_s)


def test_a_moment_of_several_periods_is_their_mean() -> None:
    loop = Loop(head_at(1000.0, 90.0), 200)
    every = round(loop.inputs._history.moment_s * 1000.0)
    assert every > 2
    # step 199 has seen the commands up to 198; the first moment began with the 0 of the start
    begun = 199 // every * every
    whole = loop.actions[begun - every - 1 : begun - 1].mean(axis=0)
    assert loop.channel("command_1")[-1] == pytest.approx(whole, abs=1e-4)
    partial = loop.actions[begun - 1 : 199].mean(axis=0)
    assert loop.channel("command_0")[-1] == pytest.approx(partial, abs=1e-4)


def test_an_outlier_does_not_enter() -> None:
    head = load_head("simulated")
    inputs = Inputs.of("history", head)
    task = begin(GazeTask(1, head=head, plant="kinematic"), 3)
    for _ in range(12):
        task.step(np.zeros((1, 4)))
    plain, other = inputs.initial()[None], inputs.initial()[None]
    fields = task.layout.fields
    for step in range(8):
        image = task.encoded.copy()
        if step == 5:  # both numbers of the left eye by 100 px
            image[:, fields["pixel_error"]][:, :2] += 100.0 / head.cameras.size[0, 0]
            image[:, fields["pixel_error_fine"]][:, :2] = 1.0
        a, b = inputs.update(task.encoded, plain)[0], inputs.update(image, other)[0]
        # what 0.02 px of noise are by 10 mrad; 100 px are 160 mrad
        differ = {inputs.names[i] for i in np.flatnonzero(np.abs(a - b) > 0.015)}
        fresh, ages = ({n for n in differ if n.startswith(w)} for w in ("fresh", "age"))
        assert fresh == ({"fresh_left_tilt", "fresh_left_pan"} if step == 5 else set())
        # what is missing is one image among those of a target at rest
        assert differ == fresh | ages
        assert not any("right" in name for name in differ)
        task.step(np.zeros((1, 4)))


def test_tied_joints_have_the_history_of_their_actuators() -> None:
    for name in ["tied", "vergeonly"]:
        with named(name):
            loop = Loop(head_of(name), 60)
            assert loop.channel("command_0")[1:] == pytest.approx(loop.actions[:-1], abs=1e-4)
            # what turns at a speed has turned by it: three periods of 1/120 s or so
            assert np.abs(loop.channel("turned_middle_0")).max() > 0.0
            assert loop.channel("fresh").max() == 1.0
