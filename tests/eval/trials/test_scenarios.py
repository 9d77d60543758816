"""Scenarios: what their trials are, that they are apart, and that every plant runs them."""

from pathlib import Path

import gymnasium
import numpy as np
import pytest

from tests.eval.trials import oracle
from tests.heads import head_of, text_of
from tests.naming import named
from vergence.controllers import make_controller
from vergence.controllers.tuned import find_tuned_or_fallback, is_tuned_for
from vergence.envs.streams import RandomStreams
from vergence.envs.targets import make_target
from vergence.envs.targets.motion import target_position
from vergence.errors import ConfigurationError, UnknownNameError, UnreachableTargetError
from vergence.eval.article.twin import TwinConfig
from vergence.eval.trials.run import run_trials
from vergence.eval.trials.scenarios import SCENARIOS, SPLITS, Scenario, load_scenario
from vergence.eval.trials.twin_errors import TWIN_ERRORS, TWIN_SPREADS
from vergence.models import parse_head

NAMES = [
    "hardware", "webcam", "desk", "step", "workspace", "circle", "line", "fast", "double-step",
    "occluded", "wander", "robust", "physical", "hardware-fast", "hardware-wander",
    "hardware-occluded", "hardware-double-step", "webcam-fast", "webcam-wander",
]  # fmt: skip
LOOPS = tuple(name for name in NAMES if name.startswith(("hardware", "webcam", "desk")))
DEGREE = np.pi / 180


def begin(scenario: Scenario, num: int, plant: str = "kinematic", split: str = "test"):
    return oracle.begin(scenario.task(num, plant), scenario.seed(split))


def motions(scenario: Scenario, num: int):
    streams, ids = RandomStreams(num), np.arange(num)
    seeds = np.full(num, scenario.seed("test"), dtype=np.uint64)
    streams.start(ids, seeds, ids.astype(np.uint64))
    return make_target(scenario.target).draw(scenario.model(), streams, ids)


def test_the_registry_holds_the_scenarios_by_their_names() -> None:
    assert list(SCENARIOS) == NAMES
    for name in NAMES:
        assert load_scenario(name).name == name
    with pytest.raises(UnknownNameError, match="hardware, webcam, desk, step, workspace"):
        load_scenario("nowhere")
    with pytest.raises(UnknownNameError, match=r"got \[\]"):
        load_scenario([])


@pytest.mark.slow
@pytest.mark.parametrize("plant", ["kinematic", "mujoco", "rendered"])
def test_every_scenario_runs_on_each_of_its_plants(plant: str) -> None:
    own = [scenario for scenario in map(load_scenario, NAMES) if plant in scenario.plants]
    assert own
    for scenario in own:
        task = begin(scenario, 2, plant)
        for _ in range(20):
            task.step(np.zeros((2, 4)))
        assert np.isfinite(task.observation).all(), scenario.name
        truth = task.truth()
        assert truth.time_s == pytest.approx(20 * scenario.model().timing.period_s), scenario.name
        task.close()


@pytest.mark.slow
def test_scenarios_run_with_any_head() -> None:
    for name, shape in [
        ("hardware", "tied"), ("webcam-fast", "mis"), ("desk", "panfirst"), ("step", "common"),
        ("robust", "vergeonly"), ("occluded", "common"), ("double-step", "vergeonly"),
    ]:  # fmt: skip
        with named(name, shape):
            scenario, head = load_scenario(name), head_of(shape)
            trials = run_trials(make_controller("ibvs", head), scenario, episodes=4, head=head)
            if name in LOOPS and not scenario.target_moves:
                # outliers, noise and play move eyes that have arrived
                assert (trials.steady_px < 8.0).all()
                continue
            found = trials.tracking_px if scenario.target_moves else trials.settle_s()
            assert np.isfinite(found).all()


def test_a_target_that_a_head_cannot_look_at_is_told_with_its_scenario() -> None:
    # nine degrees to either side: enough for a target straight ahead, not for these
    head = parse_head(text_of("panfirst").replace("0.9", "0.15"))
    controller = make_controller("ibvs", head)
    for name in ("step", "line", "fast"):
        said = f"^scenario {name}: target: expected .*another scenario"
        with pytest.raises(UnreachableTargetError, match=said):
            run_trials(controller, load_scenario(name), episodes=2, head=head)


@pytest.mark.slow
def test_both_eyes_see_the_target_at_the_start() -> None:
    seen = {name: begin(load_scenario(name), 200).truth().image_visible.all() for name in NAMES}
    assert seen == dict.fromkeys(NAMES, True)


@pytest.mark.slow
def test_both_eyes_find_the_whole_drawn_tag_however_near_the_target_is() -> None:
    task = begin(load_scenario("workspace"), 24, "rendered")
    depth = task.truth().target[:, 2]
    assert depth.min() < 0.4
    for _ in range(task.head.timing.latency_frames):
        task.step(np.zeros((24, 4), dtype=np.float32))
    assert task.reading.visible.all()
    task.close()


@pytest.mark.slow
def test_environments_take_the_options() -> None:
    for name in NAMES:
        scenario = load_scenario(name)
        env = gymnasium.make("vergence/Gaze-v0", **scenario.env_options())
        first, _info = env.reset(seed=scenario.seed("train"))
        assert np.array_equal(first, begin(scenario, 1, split="train").observation[0]), name


def test_a_plant_that_a_scenario_does_not_run_on_is_refused() -> None:
    with pytest.raises(ConfigurationError, match=r"expected one of kinematic, mujoco.*'rendered'"):
        load_scenario("robust").env_options("rendered")


def test_seeds_of_splits_and_runs_never_meet() -> None:
    scenario = load_scenario("workspace")
    firsts = sorted(scenario.seed(split, seed) for split in SPLITS for seed in (0, 1, 2, 2**20 - 1))
    assert min(np.diff(firsts)) >= 2**20
    for seed in (-1, 2**20):
        with pytest.raises(ConfigurationError, match="seed: expected 0 to"):
            scenario.seed("test", seed)
    with pytest.raises(UnknownNameError, match="train, validation, test"):
        scenario.seed("exam")


@pytest.mark.slow
def test_fast_targets_are_as_fast_as_drawn_and_within_reach() -> None:
    scenario = load_scenario("fast")
    head = scenario.model()
    rows, q = motions(scenario, 150)
    t = np.linspace(0.0, scenario.duration_s, 961)
    points = target_position(rows[:, None], t)
    middle = head.camera_poses(head.rest())[:, :3, 3].mean(axis=0)
    bearing = points - middle
    bearing /= np.linalg.norm(bearing, axis=-1, keepdims=True)
    speed = np.linalg.norm(np.diff(bearing, axis=1), axis=-1) / (t[1] - t[0]) / DEGREE
    peak = speed.max(axis=1)
    assert peak.max() <= 60.0 + 0.05
    # a slow trial may not see its ellipse's fastest part; most do
    assert np.quantile(peak, 0.05) > 15.0
    assert np.quantile(peak, 0.95) > 50.0
    angles = head.fixate(points)
    assert head.limits.contains(angles, 1.9 * DEGREE).all()
    rate = np.diff(angles, axis=1) / (t[1] - t[0])
    assert (np.abs(rate) <= 0.5 * head.limits.velocity + 0.01).all()
    bend = np.abs(np.diff(rate, axis=1)) / (t[1] - t[0])
    assert (bend[..., 3:] <= 0.5 * head.limits.acceleration[3:] + 1.0).all()
    # the eyes hold it where it stands until time zero
    assert np.abs(head.fixate(points[:, 0]) - q).max() < 1e-9
    # in all planes: some move in depth and some across
    swing = np.ptp(points[..., 2], axis=1)
    assert swing.max() > 0.3
    assert np.quantile(swing, 0.2) < 0.1


def test_robust_trials_draw_the_delays_of_the_issue() -> None:
    conditions = begin(load_scenario("robust"), 400).plant.conditions
    assert conditions.latency_s.min() == pytest.approx(0.03, abs=2e-3)
    assert conditions.latency_s.max() == pytest.approx(0.13, abs=2e-3)
    assert len(np.unique(conditions.heads, axis=0)) == 400


def test_the_guide_describes_each_scenario_as_it_is() -> None:
    guide = (Path(__file__).parents[3] / "docs" / "scenarios.md").read_text().splitlines()
    for name in NAMES:
        row = next(line for line in guide if line.startswith(f"| `{name}` |"))
        cells = [cell.strip() for cell in row.strip("|").split("|")]
        scenario = load_scenario(name)
        assert cells[1] == scenario.head, name
        assert cells[3] == f"{scenario.duration_s:g} s", name
        assert cells[4] == ", ".join(scenario.plants), name
        assert ("true head" in cells[5]) == (scenario.variation is not None), name


def test_model_errors_are_the_physical_twins() -> None:
    assert TwinConfig().errors == TWIN_SPREADS
    assert TWIN_SPREADS.scaled(0.41) == TWIN_ERRORS
    for name in ("robust", "physical"):
        variation = load_scenario(name).variation
        assert variation.model_errors == TWIN_ERRORS


def test_a_plant_of_ones_own_runs_in_every_scenario_if_it_is_simulated() -> None:
    own = "vergence.envs.plants.kinematic:KinematicPlant"
    options = load_scenario("robust").env_options(own)
    assert load_scenario("robust").task(2, own).target is not None
    assert options["plant"] == own


def test_a_plant_that_looks_at_the_world_cannot_draw_a_scenarios_targets() -> None:
    said = "expected a simulated one for the scenario 'step'"
    with pytest.raises(ConfigurationError, match=said):
        load_scenario("step").task(1, "tests.envs.robot:Robot")


@pytest.mark.parametrize(("name", "law"), [("hardware", "pid"), ("webcam", "ibvs-tuned")])
def test_the_tuned_laws_settle_in_two_pixels_through_a_robots_loop(name, law) -> None:
    scenario = load_scenario(name)
    head = scenario.model()
    entry = find_tuned_or_fallback(law, name, head)
    assert is_tuned_for(entry, head)
    controller = make_controller(law, head, **entry.options)
    trials = run_trials(controller, scenario, episodes=40, split="validation")
    assert np.isfinite(trials.settle_s(2.0)).mean() >= 0.95
