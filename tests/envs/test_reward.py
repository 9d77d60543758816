"""Reward, success and the end of an episode."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.controllers.loops import begin
from vergence import load_head, make_controller
from vergence.envs.reading import Reading
from vergence.envs.reward import JUDGE, TERMS, TaskArrays, advance_task
from vergence.envs.task import GazeTask

STILL = np.zeros((1, 4))


def terms_of(task: GazeTask) -> dict[str, float]:
    return {name: float(value[0]) for name, value in task.info()["reward_terms"].items()}


def test_reward_is_the_sum_of_its_terms() -> None:
    task = begin(GazeTask(5, plant="kinematic"))
    rng = np.random.default_rng(0)
    for _ in range(200):
        task.step(rng.uniform(-1, 1, (5, 4)))
        terms = task.info()["reward_terms"]
        assert tuple(terms) == TERMS
        assert task.reward == pytest.approx(sum(terms.values()), abs=1e-12)


def test_tracking_and_precision_follow_their_formula() -> None:
    # a jump of 1.5 mm in height at 1 m is 0.93 px, one of 30 mm is 19 px
    for height in (0.0015, 0.03):
        after = (0.0, -0.1 - height, 1.0)
        head = load_head("simulated").replace(sensor={"detection_noise_px": 0.0})
        target = {"kind": "step", "after": after}
        task = begin(GazeTask(1, head=head, plant="kinematic", target=target))
        for _ in range(8):
            task.step(STILL)
        size = np.linalg.norm(task.pixel_error[0], axis=-1)
        assert size == pytest.approx(height * 620.0, rel=0.05)
        terms = terms_of(task)
        coarse = (10.0 / (10.0 + size) + 100.0 / (100.0 + size)) / 6.0
        assert terms["tracking"] == pytest.approx(coarse.sum(), abs=1e-12)
        assert terms["precision"] == pytest.approx((1.0 / (1.0 + size)).sum() / 6.0, abs=1e-12)
        assert terms["effort"] == 0.0


def test_the_best_gaze_earns_one_a_step() -> None:
    head = load_head("simulated").replace(sensor={"detection_noise_px": 0.0})
    target = {"kind": "step", "before": (0.0, -0.1, 1.0), "after": (0.0, -0.1, 1.0)}
    task = begin(GazeTask(1, head=head, plant="kinematic", target=target))
    task.step(STILL)
    assert 0.97 < task.reward[0] <= 1.0  # encoder steps keep the start some 0.1 px away


def test_effort_takes_a_hundredth_of_what_is_earned_times_the_mean_square_of_the_action() -> None:
    task = begin(GazeTask(1, plant="kinematic"))
    for _ in range(9):
        task.step(np.array([[0.5, -7.0, 0.0, 1.0]]))
    terms = terms_of(task)
    earned = terms["tracking"] + terms["precision"]
    assert earned > 0.0
    square = (0.25 + 1.0 + 1.0) / 4
    assert terms["effort"] == pytest.approx(-0.01 * earned * square, abs=1e-15)


def test_a_step_in_which_one_eye_sees_earns_nothing() -> None:
    # 43 degrees aside of the left eye and 38 of the right: only the right one sees it
    point = (-0.85, 0.0, 1.0)
    task = begin(GazeTask(1, plant="kinematic", target={"kind": "static", "point": point}))
    for _ in range(8):
        task.step(STILL)
    assert task.reading.visible[0].sum() == 1
    assert task.reward[0] == 0.0


def test_success_is_a_tenth_of_a_second_within_a_pixel() -> None:
    task = begin(GazeTask(4, plant="kinematic"))
    controller = make_controller("ibvs", head=task.head)
    inside = np.zeros(4, dtype=int)
    for _ in range(240):
        action, _state = controller.predict(task.observation)
        task.step(action)
        settled = (np.linalg.norm(task.pixel_error, axis=-1) < 1.0).all(axis=1)
        inside = np.where(settled, inside + 1, 0)
        assert np.array_equal(task.info()["is_success"], inside >= 12)
    assert task.success.all()


def test_a_lost_target_ends_the_episode_half_a_second_after_it_was_last_seen() -> None:
    task = begin(GazeTask(1, plant="kinematic", target={"kind": "static"}))
    unseen, seen = 0, False
    for step in range(240):
        task.step(np.array([[0.0, 1.0, 0.0, 1.0]]) * (step > 10))
        both = task.reading.visible.all()
        seen |= bool(both)
        unseen = unseen + 1 if seen and not both else 0
        assert task.lost[0] == (unseen >= 60)
        assert terms_of(task)["lost"] == (-25.0 if unseen >= 60 else 0.0)
        if task.lost[0]:
            return
    pytest.fail("the target was never lost")


def test_a_glance_away_is_forgiven() -> None:
    task = begin(GazeTask(1, plant="kinematic", target={"kind": "static"}))
    blind = 0
    for step in range(200):
        # away for 0.2 s, then back for as long
        side = 1.0 * (10 < step <= 34) - 1.0 * (34 < step <= 58)
        task.step(np.array([[0.0, side, 0.0, side]]))
        blind += step > 8 and not task.reading.visible.all()
        assert not task.lost[0]
    assert 10 < blind < 60
    assert task.reading.visible.all()


def test_a_target_that_is_never_seen_is_lost_after_a_second_and_a_half() -> None:
    # beside a place that sees it and goes on
    dropped = {"dropped_frame_probability": np.array([1.0, 0.0])}
    task = begin(GazeTask(2, plant="kinematic", target="static", plant_options=dropped))
    for step in range(1, 181):
        task.step(np.zeros((2, 4)))
        assert not task.reading.visible[0].any()
        assert task.lost.tolist() == [step == 180, False]
        assert task.reward[0] == (-25.0 if step == 180 else 0.0)


def test_a_target_first_seen_late_has_half_a_second_from_then_on() -> None:
    script = np.zeros((170 + 70, 2), dtype=bool)
    script[170] = True
    lost = [step for step, outcome in enumerate(assessed(script)) if outcome[1]]
    assert lost[0] == 170 + 60


def test_a_head_that_misses_periods_loses_its_target_after_the_same_seconds() -> None:
    task = begin(GazeTask(1, plant="tests.envs.robot:Late"))
    seen_s = 0.0
    while not task.lost[0]:
        task.step(STILL)
        if task.reading.time_s[0] > 1.0:
            task.plant.blind = True
        if task.reading.visible.all():
            seen_s = task.reading.time_s[0]
        assert task.reading.time_s[0] < 2.0
    # found out at the first step from then on, a period later if that one is missed
    assert 0.5 - 1e-9 <= task.reading.time_s[0] - seen_s < 0.5 + 1.5 * task.head.timing.period_s
    assert task.plant.steps < 0.9 * task.reading.time_s[0] / task.head.timing.period_s


def assessed(script, name="simulated", seed=0):
    """Rewards and losses by step, with eyes that see by a script and targets anywhere in view."""
    head = load_head(name)
    rng, task, reading = np.random.default_rng(seed), TaskArrays.empty(head, 1), Reading.empty(1)
    task.progress.begin(np.arange(1), head.timing.period_s)
    reading.positions_at_exposure[:] = reading.positions[:] = head.rest()
    width_height = (640.0, 480.0)
    found = []
    for sees in script:
        reading.visible[0] = sees
        anywhere = rng.uniform(0.0, width_height, (2, 2))
        reading.pixels[0] = np.where(np.reshape(sees, (2, 1)), anywhere, np.nan)
        task.action[:] = rng.uniform(-1.0, 1.0, task.action.shape)
        advance_task(np.arange(1), task, reading, JUDGE)
        found.append((float(task.result.reward[0]), bool(task.result.lost[0])))
        reading.time_s[0] += head.timing.period_s
    return found


def glances(longest):
    """Strategy for the visibility in both eyes, in runs of up to `longest` steps."""
    eyes = st.tuples(st.booleans(), st.booleans())
    run = st.tuples(eyes, st.integers(1, longest))
    return st.lists(run, min_size=1, max_size=8).map(
        lambda runs: np.repeat([sees for sees, _ in runs], [k for _, k in runs], axis=0)
    )


@pytest.mark.slow
@pytest.mark.parametrize("name", ["simulated", "icub"])
@settings(max_examples=20, deadline=None)
@given(script=glances(90), seed=st.integers(0, 2**32 - 1))
def test_nothing_costs_but_being_lost(name, script, seed) -> None:
    """So an episode that goes on earns more than one that is lost, whatever the discount.

    What is left of an episode earns at least 0 where it goes on, and -25 where it is lost.
    """
    for reward, lost in assessed(script, name, seed):
        assert reward == -25.0 if lost else 0.0 <= reward <= 1.0
