"""Reward, success and the end of an episode."""

import numpy as np
import pytest

from vergence import ModelErrors, load_head, make_controller
from vergence.envs.reward import TERMS
from vergence.envs.task import GazeTask
from vergence.errors import ConfigurationError, UnknownNameError, VergenceError

ZERO = np.zeros(1, dtype=np.uint64)
STILL = np.zeros((1, 4))


def begin(task: GazeTask) -> GazeTask:
    num = task.num
    task.begin(np.arange(num), np.zeros(num, np.uint64), np.arange(num, dtype=np.uint64))
    return task


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
    # a jump of 1.5 mm in height at 1 m is 0.93 px, one of 3 mm is 1.9 px
    for height, precise in ((0.0015, 1.0), (0.003, 0.0)):
        after = (0.0, -0.1 - height, 1.0)
        head = load_head("simulated").replace(sensor={"detection_noise_px": 0.0})
        task = begin(
            GazeTask(1, head=head, plant="kinematic", target={"kind": "step", "after": after})
        )
        for _ in range(8):
            task.step(STILL)
        size = np.linalg.norm(task.pixel_error[0], axis=-1)
        terms = terms_of(task)
        assert terms["tracking"] == pytest.approx(-(size / (size + 20.0)).mean(), abs=1e-12)
        assert terms["precision"] == precise
        assert terms["effort"] == 0.0


def test_effort_is_a_hundredth_of_the_mean_square_of_the_limited_action() -> None:
    task = begin(GazeTask(1, plant="kinematic"))
    task.step(np.array([[0.5, -7.0, 0.0, 1.0]]))
    assert terms_of(task)["effort"] == pytest.approx(-0.01 * (0.25 + 1.0 + 1.0) / 4, abs=1e-15)


def test_an_eye_that_does_not_see_costs_as_much_as_the_worst_error() -> None:
    head = load_head("simulated")
    # 43 degrees aside of the left eye and 38 of the right: only the right one sees it
    point = (0.85, 0.0, 1.0) @ np.diag([-1.0, 1.0, 1.0])
    task = begin(
        GazeTask(1, head=head, plant="kinematic", target={"kind": "static", "point": point})
    )
    for _ in range(8):
        assert terms_of(task)["tracking"] == 0.0
        task.step(STILL)
    visible = task.reading.visible[0]
    assert visible.sum() == 1
    size = np.linalg.norm(task.pixel_error[0][visible])
    assert terms_of(task)["tracking"] == pytest.approx(-0.5 - 0.5 * size / (size + 20.0))


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


def test_a_target_that_was_never_seen_ends_nothing() -> None:
    blind = {"dropped_frame_probability": 1.0}
    task = begin(GazeTask(1, plant="kinematic", target="static", plant_options=blind))
    for _ in range(240):
        task.step(STILL)
        assert not task.reading.visible.any()
        assert not task.lost[0]
        assert task.reward[0] == 0.0


def test_model_errors_give_every_head_its_own_and_the_controller_none() -> None:
    errors = {"joint_offset_rad": 0.01}
    task = GazeTask(3, plant="kinematic", model_errors=errors, model_seed=4)
    assert task.head == load_head("simulated")
    offsets = task.plant.true_head.links.offset - task.head.links.offset
    assert len(np.unique(offsets[:, 3])) == 3
    same = GazeTask(3, plant="kinematic", model_errors=ModelErrors(**errors), model_seed=4)
    assert np.array_equal(same.plant.true_head.packed, task.plant.true_head.packed)
    other = GazeTask(3, plant="kinematic", model_errors=errors, model_seed=5)
    assert not np.array_equal(other.plant.true_head.packed, task.plant.true_head.packed)


def test_info_on_request_has_truth_and_both_fixes() -> None:
    task = begin(GazeTask(2, plant="kinematic", info=("truth", "fixes")))
    for _ in range(12):
        task.step(np.zeros((2, 4)))
    info = task.info()
    assert np.array_equal(info["truth"]["target"], task.truth().target)
    gaze, views = task.fixes()
    assert np.array_equal(info["gaze"]["point"], gaze.point, equal_nan=True)
    # the eyes are still, so the image's fix is the target, up to 0.03 px: 2 mm at 1 m
    error = np.abs(info["itpc"]["point"] - task.truth().target)
    assert (error < 6 * views.sigma).all()
    assert set(begin(GazeTask(1, plant="kinematic")).info()) == {"is_success", "reward_terms"}


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        (
            {"plant": "wooden"},
            UnknownNameError,
            "plant: expected one of kinematic, mujoco.*'wooden'",
        ),
        ({"head": "nobody"}, VergenceError, "nobody"),
        (
            {"info": ("truht",)},
            ConfigurationError,
            "info: expected some of fixes, truth, got 'truht'",
        ),
        (
            {"model_errors": {"join_rad": 0.1}},
            ConfigurationError,
            r"model_errors\.join_rad: expected one of link_m.*'join_rad' = 0.1",
        ),
        (
            {"model_errors": {}, "plant_options": {"true_head": load_head("simulated")}},
            ConfigurationError,
            "either model_errors or true_head",
        ),
    ],
)
def test_arguments_that_cannot_be_are_refused_by_name(options, error, message) -> None:
    with pytest.raises(error, match=message):
        GazeTask(1, **options)
