"""Every controller of the registry: what `predict` promises, and that it looks at the target."""

import numpy as np
import pytest

from tests.controllers.loops import begin, drive, true_errors
from tests.heads import head_of
from tests.naming import named
from vergence import load_head, make_controller
from vergence.controllers import CONTROLLERS, Controller
from vergence.envs.observation import ObservationLayout
from vergence.envs.task import GazeTask
from vergence.errors import ConfigurationError

HEAD = load_head("simulated")
LAYOUT = ObservationLayout.of(HEAD)
LEARNED = ("learned-gain", "learned-policy")


def made(name: str) -> Controller:
    """The controller with its own defaults."""
    return make_controller(name, head=HEAD)


def observations(*shape: int, seed: int = 3, layout: ObservationLayout = LAYOUT) -> np.ndarray:
    """Random observations of newest images, all that a layout allows."""
    rng = np.random.default_rng(seed)
    observation = rng.uniform(layout.low(), layout.high(), (*shape, layout.size))
    observation[..., layout.fields["visible"]] = rng.random((*shape, 2)) < 0.8
    observation[..., layout.fields["image_age"]] = HEAD.timing.latency_s / 0.5
    # the fine channel says the same as the coarse one
    coarse = observation[..., layout.fields["pixel_error"]]
    width = HEAD.cameras.size[0, 0]
    observation[..., layout.fields["pixel_error_fine"]] = np.clip(coarse * width / 16.0, -1, 1)
    return observation.astype(np.float32)


def same(a: object, b: object) -> bool:
    """True if two states hold the same numbers, or are both None."""
    if a is None or b is None:
        return a is b
    return all(np.array_equal(x, y, equal_nan=True) for x, y in zip(a, b, strict=True))


def test_actions_are_bounded_numbers_of_the_actuators_in_the_batchs_shape() -> None:
    tied = head_of("tied")
    for name in CONTROLLERS:
        for head, count in ((HEAD, 4), (tied, 3)):
            if head is tied and name in LEARNED:
                continue
            for shape in ((), (2, 3)):
                with named(name, head.name, shape):
                    controller, state = make_controller(name, head), None
                    layout = ObservationLayout.of(head)
                    for step in range(4):
                        seen = observations(*shape, seed=step, layout=layout)
                        action, state = controller.predict(seen, state)
                        assert (action.dtype, action.shape) == (np.float32, (*shape, count))
                        assert (np.abs(action) <= 1.0).all()
                        assert all(part.shape[: len(shape)] == shape for part in state or ())


def test_a_batch_is_the_loop_over_its_rows() -> None:
    for name in CONTROLLERS:
        with named(name):
            controller, state, states = made(name), None, [None] * 6
            for step in range(8):
                batch = observations(6, seed=step)
                actions, state = controller.predict(batch, state)
                for i in range(6):
                    action, states[i] = controller.predict(batch[i], states[i])
                    # a network's products may be added up in another order for a batch
                    close = 1e-5 if name in LEARNED else 1e-7
                    assert action == pytest.approx(actions[i], abs=close)


def test_an_episodes_start_forgets_its_own_row_alone() -> None:
    for name in CONTROLLERS:
        with named(name):
            controller, state = made(name), None
            for step in range(6):
                _action, state = controller.predict(observations(4, seed=step), state)
            now = observations(4, seed=99)
            start = np.array([False, True, False, True])
            action, after = controller.predict(now, state, start)
            fresh, fresh_state = controller.predict(now, None)
            went_on, went_on_state = controller.predict(now, state)
            close = 1e-5 if name in LEARNED else 0.0
            assert action[start] == pytest.approx(fresh[start], abs=close)
            assert action[~start] == pytest.approx(went_on[~start], abs=close)
            if after is not None:
                for part, new, old in zip(after, fresh_state, went_on_state, strict=True):
                    assert np.allclose(part[start], new[start], atol=1e-5, equal_nan=True)
                    assert np.allclose(part[~start], old[~start], atol=1e-5, equal_nan=True)


def test_neither_the_observation_nor_the_state_that_came_is_changed() -> None:
    for name in CONTROLLERS:
        with named(name):
            controller, state = made(name), None
            for step in range(3):
                _action, state = controller.predict(observations(3, seed=step), state)
            now = observations(3, seed=9)
            kept, kept_state = now.copy(), state and tuple(part.copy() for part in state)
            first, after = controller.predict(now, state, np.array([True, False, False]))
            assert np.array_equal(now, kept)
            assert same(state, kept_state)
            again, after_again = controller.predict(now, state, np.array([True, False, False]))
            assert np.array_equal(first, again)
            assert same(after, after_again)


def test_a_state_of_another_batch_is_refused() -> None:
    with pytest.raises(ConfigurationError, match="state: expected a tuple of one array of shape"):
        made("saccade").predict(observations(3), (np.zeros((2, 5)),))


def test_a_target_that_was_never_seen_moves_nothing_and_gives_no_nan() -> None:
    def cover(observation: np.ndarray, _step: int) -> None:
        observation[:, : LAYOUT.fields["visible"].stop] = 0.0

    for name in CONTROLLERS:
        with named(name):
            task = begin(GazeTask(2, head=HEAD, plant="kinematic", target={"kind": "static"}))
            for action in drive(task, made(name), 0.25, cover):
                assert np.isfinite(action).all()
                # a learned law may search for what it does not see
                assert name in LEARNED or not action.any()


@pytest.mark.parametrize("name", CONTROLLERS)
def test_a_target_at_rest_is_brought_to_both_principal_points(name) -> None:
    plant = ("kinematic", "mujoco")[list(CONTROLLERS).index(name) % 2]
    task = GazeTask(4, head=HEAD, plant=plant)
    errors = np.linalg.norm(true_errors(task, made(name), 2.0), axis=-1)
    assert errors[0].max() > 50.0
    # detection noise of 0.02 px, carried on through the delay, is far below a pixel
    assert errors[-24:].max() < 1.0


def test_an_option_that_no_controller_has_is_refused_by_name() -> None:
    for name in CONTROLLERS:
        with pytest.raises(ConfigurationError, match=rf"controller {name}: .*colour"):
            make_controller(name, head=HEAD, colour="red")


def test_options_that_cannot_be_are_refused_by_name() -> None:
    for name, option, value, message in [
        ("ibvs", "gain", -1.0, "expected finite gains >= 0, got -1.0"),
        ("ibvs", "gain", [1.0, 2.0, 3.0], r"expected a number, \(k1, k2\).*\[1.0, 2.0, 3.0\]"),
        ("ibvs", "gain", "high", "expected a number.*'high'"),
        ("ibvs", "depth", "guessed", "expected 'triangulated' or metres, got 'guessed'"),
        ("ibvs", "depth", 0.0, "expected metres above 0, got 0.0"),
        ("ibvs", "speed_limit", -2.0, "expected rad/s above 0, got -2.0"),
        ("pid", "kp", -1.0, "expected finite gains >= 0, got -1.0"),
        ("pid", "filter_s", -0.1, "expected a number of at least 0"),
        ("fuzzy", "span_p", 1.5, "expected 0 to 1, got 1.5"),
        ("fuzzy", "error_px", 0.0, "expected a finite number above 0"),
        ("adaptive", "lambda_zero", -1.0, "expected a number of at least 0, got -1.0"),
        ("adaptive", "lambda_inf", np.nan, "expected a finite number"),
        ("adaptive", "slope_zero", np.inf, "expected a finite number"),
        ("saccade", "braking", 0.0, "expected"),
        ("saccade", "caution", -1.0, "expected"),
        ("saccade", "trim_px", -1.0, "expected"),
        ("saccade", "trim_gain", 0.0, "expected"),
        ("saccade", "lag", "known", "expected"),
        ("pursuit", "braking", 1.5, "expected a share above 0 up to 1, got 1.5"),
        ("state-feedback", "gain", 0.0, "expected"),
        ("state-feedback", "damping", -0.1, "expected"),
        ("state-feedback", "damping", True, "expected"),
        ("state-feedback", "gain", 10**400, "expected a finite number, got 1000"),
        ("state-feedback", "gain", np.timedelta64(4, "s"), "expected a number, got np.timedelta"),
        ("ibvs", "gain", 10**400, "expected a number, .* got 1000"),
        ("ibvs-tuned", "scenario", [], r"expected a name, got \[\]"),
    ]:
        said = rf"{option}: {message}"
        with named(name, option, value), pytest.raises(ConfigurationError, match=said):
            make_controller(name, head=HEAD, **{option: value})


def test_an_episodes_start_of_another_batch_is_refused() -> None:
    controller = make_controller("saccade", head=HEAD)
    seen = np.zeros((2, 27), dtype=np.float32)
    _action, state = controller.predict(seen)
    with pytest.raises(ConfigurationError, match=r"episode_start: expected shape \(2,\), got \(3,"):
        controller.predict(seen, state, episode_start=[True, False, True])


def test_what_is_no_observation_is_refused() -> None:
    for name in CONTROLLERS:
        with named(name):
            controller = made(name)
            for wrong, message in (
                (np.zeros(26), r"expected shape \(\.\.\., 27\), got \((3, )?26,?\)"),
                (np.zeros(27, dtype=np.int64), "floating-point numbers, got an array of int64"),
                (np.zeros(27, dtype=object), "floating-point numbers, got an array of object"),
                (np.full(27, np.nan), "finite numbers, got nan"),
            ):
                for observation in (wrong, np.tile(wrong, (3, 1))):
                    with pytest.raises(ConfigurationError, match=message):
                        controller.predict(observation)


def test_another_heads_layout_is_refused() -> None:
    other, said = ObservationLayout.of(load_head("physical")), "another head's, which differs in sc"
    for name in CONTROLLERS:
        with named(name), pytest.raises(ConfigurationError, match=said):
            make_controller(name, HEAD, other)
