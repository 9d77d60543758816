"""Variation between trials: drawn from the trial's stream, hidden from the controller."""

import dataclasses
import inspect
import pickle
import re

import gymnasium
import numpy as np
import pytest
from scipy import stats

from tests.envs.trials import EVERYTHING
from tests.naming import named, refused
from vergence import HeadModel, ModelErrors, load_head
from vergence.envs.plant import make_plant, simulation_of
from vergence.envs.plants.conditions import (
    IMPERFECTIONS,
    PER_ACTUATOR,
    PER_TRIAL,
    RANGES,
    Conditions,
    Variation,
    make_variation,
)
from vergence.envs.plants.kinematic import KinematicPlant
from vergence.envs.task import GazeTask
from vergence.errors import ConfigurationError


def begin(task: GazeTask, trials, ids=None, seed: int = 7) -> GazeTask:
    ids = np.arange(task.num) if ids is None else ids
    trials = np.asarray(trials, dtype=np.uint64)
    task.begin(ids, np.full(len(ids), seed, np.uint64), trials)
    return task


def run(task: GazeTask, place: int, count: int) -> np.ndarray:
    """Everything that one place reports, under actions that depend on the time alone."""
    rows = []
    for step in range(count):
        action = 0.3 * np.sin(0.13 * step + np.arange(4.0))
        task.step(np.broadcast_to(action, (task.num, 4)).copy())
        error = task.truth().pixel_error[place].ravel()
        rows.append(np.concatenate([task.observation[place], error]))
    return np.array(rows)


def conditions(task: GazeTask) -> Conditions:
    return task.plant.conditions


def test_every_reset_of_a_place_draws_anew() -> None:
    task = begin(GazeTask(4, plant="kinematic", variation=EVERYTHING), range(4))
    before = [values.copy() for values in conditions(task)]
    begin(task, [9], ids=np.array([2]))
    changed = [a != b for a, b in zip(before, conditions(task), strict=True)]
    for values in changed:
        assert values[2].any()
        assert not values[[0, 1, 3]].any()


@pytest.mark.parametrize("plant", ["kinematic", "mujoco"])
def test_a_trial_is_the_same_alone_in_a_vector_and_after_others(plant) -> None:
    alone = run(begin(GazeTask(1, plant=plant, variation=EVERYTHING), [5]), 0, 60)
    among = run(begin(GazeTask(4, plant=plant, variation=EVERYTHING), [1, 2, 3, 5]), 3, 60)
    again = GazeTask(1, plant=plant, variation=EVERYTHING)
    run(begin(again, [3]), 0, 20)
    after = run(begin(again, [5]), 0, 60)
    assert np.array_equal(alone, among, equal_nan=True)
    assert np.array_equal(alone, after, equal_nan=True)


def test_draws_are_uniform_in_their_ranges_and_independent() -> None:
    task = begin(GazeTask(2400, plant="kinematic", variation=EVERYTHING), range(2400))
    found = conditions(task)
    samples = []
    for name in RANGES:
        span = getattr(make_variation(EVERYTHING), name)
        values = getattr(found, name)
        columns = values.T[3:] if values.ndim > 1 else [values]
        samples += [(column - span[0]) / (span[1] - span[0]) for column in columns]
    for sample in samples:
        # far below what chance gives once in a hundred for one of them, and far above a wrong one's
        assert stats.kstest(sample, "uniform").pvalue > 1e-4
    pairs = np.corrcoef(samples) - np.eye(len(samples))
    assert len(samples) == len(PER_TRIAL) + 4 * len(PER_ACTUATOR)
    assert np.abs(pairs).max() < 0.09


def test_true_heads_deviate_by_the_model_errors(simulated: HeadModel) -> None:
    variation = {"model_errors": EVERYTHING["model_errors"]}
    task = begin(GazeTask(4000, plant="kinematic", variation=variation), range(4000))
    true = simulation_of(task.plant).true_head
    assert np.array_equal(true.packed, conditions(task).heads)
    offset = true.links.offset - simulated.links.offset
    # both tilts have the common part, with opposite signs: left down, right up
    for frame, variance in ((4, 1e-4), (3, 2e-4), (6, 2e-4)):
        assert offset[:, frame].var() == pytest.approx(variance, rel=0.1)
    assert np.mean(offset[:, 3] * offset[:, 6]) == pytest.approx(-1e-4, rel=0.15)
    principal = true.cameras.principal - simulated.cameras.principal
    # four thousand draws know a standard deviation to about one percent
    assert principal.std(axis=0) == pytest.approx(np.ones((2, 2)), rel=0.05)


def test_what_does_not_vary_is_what_the_plant_was_given(simulated: HeadModel) -> None:
    options = {"lag_s": 0.05, "detection_noise_px": [0.1, 0.2]}
    task = GazeTask(2, plant="kinematic", variation={"latency_s": (0, 0.1)}, plant_options=options)
    found = conditions(begin(task, [0, 1]))
    assert found.lag_s == pytest.approx([0.05, 0.05])
    assert found.detection_noise_px == pytest.approx([0.1, 0.2])
    assert np.array_equal(found.heads, simulated.packed[None])


def test_a_drawn_condition_acts_like_the_plants_own_option() -> None:
    options = {
        "latency_s": 0.0871, "lag_s": 0.05, "frame_rate_hz": 47.0, "frame_phase": 0.3,
        "clock_drift": 0.004, "jitter_s": 0.01, "command_latency_s": 0.011,
        "feedback_latency_s": 0.007, "acceleration_ratio": 0.7, "torque_falloff": 0.4,
        "onset_s": 0.05, "speed_gain": 1.1, "outlier_probability": 0.2,
        "missed_detection_probability": 0.1, "angle_noise_rad": 0.001, "speed_noise_rad_s": 0.01,
    }  # fmt: skip
    variation = {name: (value, value) for name, value in options.items()}
    drawn = run(begin(GazeTask(1, plant="kinematic", variation=variation), [5]), 0, 50)
    given = run(begin(GazeTask(1, plant="kinematic", plant_options=options), [5]), 0, 50)
    assert np.array_equal(drawn, given, equal_nan=True)


def test_the_observation_tells_nothing_of_an_unknown_delay() -> None:
    # the image's age counts from receipt plus the nominal 8 periods, whatever the delay is
    task = begin(GazeTask(50, plant="kinematic", target="step", variation=EVERYTHING), range(50))
    run(task, 0, 20)
    age = task.layout.decode(task.observation).image_age_s
    since_receipt = task.reading.time_s - task.reading.received_s
    assert np.ptp(conditions(task).latency_s) > 0.05
    assert age == pytest.approx(8 / 120 + since_receipt, abs=1e-6)


def test_an_environment_takes_a_variation_by_its_fields() -> None:
    env = gymnasium.make("vergence/Gaze-v0", plant="kinematic", variation=EVERYTHING)
    vector = gymnasium.make_vec("vergence/Gaze-v0", 3, plant="kinematic", variation=EVERYTHING)
    env.reset(seed=3)  # whose trial of the same number has another head
    env.reset(seed=12)
    vector.reset(seed=10)
    single = conditions(env.unwrapped.task)
    many = conditions(vector.unwrapped.task)
    for one, all_of_them in zip(single, many, strict=True):
        assert np.array_equal(one[0], all_of_them[2])


def test_the_rendered_plant_varies_its_timing_and_refuses_the_rest() -> None:
    variation = {"latency_s": (0.0, 0.02), "lag_s": (0.02, 0.04)}
    task = begin(GazeTask(2, plant="rendered", target="static", variation=variation), [0, 1])
    first = np.full(2, -1)
    for step in range(4):
        first[(first < 0) & task.reading.visible.all(axis=1)] = step
        task.step(np.zeros((2, 4)))
    assert np.array_equal(first, np.ceil(conditions(task).latency_s * 120.0))
    with pytest.raises(ConfigurationError, match=r"skew_s: expected 0, got 0\.004"):
        make_plant("rendered", load_head("simulated"), skew_s=0.004)
    for name in ("detection_noise_px", "skew_s", "model_errors"):
        with pytest.raises(ConfigurationError, match=rf"variation\.{name}: expected .*Rendered"):
            GazeTask(1, plant="rendered", variation={name: EVERYTHING[name]})


def test_variations_and_options_that_cannot_be_are_refused() -> None:
    head, errors = load_head("simulated"), ModelErrors(joint_offset_rad=0.01)
    unknown = r"variation\.delay_s: expected one of latency_s.*got 'delay_s'"
    refused(unknown, make_variation, {"delay_s": (0, 1)})
    ordered = r"variation\.lag_s: expected least <= greatest, got"
    refused(ordered, make_variation, {"lag_s": (0.06, 0.03)})
    for wrong in (0.03, "12", (0.5, 0.5, 0.5), {0.5, 0.6}, {0.5: 0, 0.6: 0}):
        said = rf"variation\.lag_s: expected two numbers, got .*{re.escape(str(wrong)[1:4])}"
        refused(said, make_variation, {"lag_s": wrong})
    fields = r"variation\.model_errors\.link: expected one of link_m"
    refused(fields, make_variation, {"model_errors": {"link": 1.0}})
    by_name = "model_errors: expected standard deviations by"
    refused(by_name, make_variation, {"model_errors": 0.1})
    refused(f"^{by_name}", GazeTask, 1, plant="kinematic", model_errors=[0.1])
    drawn = {"plant": "kinematic", "variation": Variation(model_errors=errors)}
    for other in ({"model_errors": errors}, {"plant_options": {"true_head": head}}):
        refused(r"expected one of variation\.model_errors", GazeTask, 1, **drawn, **other)
    masses = r"lag_s: expected seconds above 0, got \(0.0"
    refused(masses, make_plant, "mujoco", head, variation=Variation(lag_s=(0.0, 0.03)))
    for wrong in ("2", True, -1, 1.0):
        said = "nthread: expected a whole number of at least 0"
        refused(said, make_plant, "mujoco", head, 2, nthread=wrong)


def test_milliseconds_are_refused_with_a_hint() -> None:
    for name in (name for name in RANGES if IMPERFECTIONS[name].unit == "s"):
        hint = rf"{name}: .*from 0 to below 10? \(is it in milliseconds\?\)"
        refused(hint, GazeTask, 1, plant="kinematic", variation={name: (30, 130)})


@pytest.mark.slow
def test_every_range_and_option_is_checked_by_its_name() -> None:
    for name in RANGES:
        with named(name):
            head, one = load_head("simulated"), IMPERFECTIONS[name]
            refused(rf"^variation\.{name}: expected .*, got", make_variation, {name: (0.13, 0.03)})
            with pytest.raises(ConfigurationError, match=rf"^{name}: expected .*, got nan"):
                make_plant("kinematic", head, 2, **{name: np.nan})
            beyond = [one.least - 0.5]
            if one.most < np.inf:
                beyond.append(one.most + (0.0 if one.unit == "s" else 0.5))
            for value in beyond:
                refused(f"variation.{name}: expected", make_variation, {name: (value, value)})
                with pytest.raises(ConfigurationError, match=f"{name}: expected"):
                    GazeTask(1, plant="kinematic", plant_options={name: value})


def test_what_is_no_finite_number_is_refused_as_option_and_as_range() -> None:
    for wrong in ("0.5", True, None, np.nan, -np.inf, 0.5j, ["0.5", "0.5"], [True, 0.5], {}):
        with named(wrong):
            pair = wrong if isinstance(wrong, list | dict) else (0.5, wrong)
            said = r"lag_s: expected .*, got [^\n]*$"
            refused(r"^variation\." + said, make_variation, {"lag_s": pair})
            if wrong is not None:  # which says nothing, and the head's own holds
                refused(f"^{said}", make_plant, "kinematic", load_head("simulated"), 2, lag_s=wrong)


def test_options_of_the_loop_are_in_the_plants_signature_and_checked_by_name() -> None:
    head = load_head("simulated")
    assert {*IMPERFECTIONS} < inspect.signature(KinematicPlant).parameters.keys()
    refused(r"latncy_s: .*did you mean latency_s\?", make_plant, "mujoco", head, latncy_s=0.04)


def test_a_variation_is_a_value() -> None:
    one = make_variation(EVERYTHING)
    assert hash(one) == hash(pickle.loads(pickle.dumps(one)))
    other = dataclasses.replace(one, speed_filter_s=[0.04, 0.04])
    assert other.speed_filter_s == (0.04, 0.04)
