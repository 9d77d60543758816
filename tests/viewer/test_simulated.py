"""A simulated head that a person plays with, without a browser."""

import numpy as np
import pytest

from vergence.errors import ConfigurationError
from vergence.models.head_file import load_head
from vergence.viewer.simulated import STEP_S, Setup, SimulatedHead

SETUP = Setup(head=load_head("simulated"), plant="kinematic")


def run(simulated: SimulatedHead, seconds: float) -> None:
    for _ in range(round(seconds / simulated.period_s)):
        simulated.step()


def test_the_eyes_settle_on_a_target_that_is_moved_by_hand():
    simulated = SimulatedHead(SETUP)
    for point in ([0.2, -0.1, 0.8], [-0.1, 0.05, 1.4]):
        simulated.move_target(np.array(point))
        run(simulated, 1.0)
        shown = simulated.moment()
        assert shown.target == pytest.approx(point)
        assert (shown.errors_px < 1.0).all()
        assert shown.fix.point == pytest.approx(point, abs=5e-3)
        assert 0.1 < simulated.settled_s < 0.6


def test_no_settling_is_timed_on_a_target_that_was_there_from_the_beginning():
    simulated = SimulatedHead(SETUP)
    run(simulated, 0.5)
    assert (simulated.moment().errors_px < 1.0).all()
    assert simulated.settled_s is None


@pytest.mark.slow
def test_a_jump_is_timed_against_its_bound():
    simulated = SimulatedHead(SETUP, seed=3)
    run(simulated, 1.0 + 3 * STEP_S - 0.1)
    assert simulated.bound_s is not None
    assert simulated.bound_s <= simulated.settled_s < 2.0 * simulated.bound_s


def test_images_show_where_the_target_was_when_they_were_exposed():
    simulated = SimulatedHead(SETUP)
    run(simulated, 0.5)
    before = simulated.moment().pixels
    simulated.move_target(np.array([0.2, -0.1, 0.8]))
    run(simulated, 0.5 * SETUP.head.timing.latency_s)
    assert simulated.moment().pixels == pytest.approx(before, abs=1.0)
    run(simulated, SETUP.head.timing.latency_s)
    assert np.abs(simulated.moment().pixels - before).max() > 20.0


@pytest.mark.slow
def test_pursuit_stays_on_a_target_that_moves():
    setup = Setup(head=SETUP.head, plant="kinematic", controller="pursuit")
    for mode in ("circle", "wander"):
        simulated = SimulatedHead(setup, mode=mode)
        run(simulated, 1.0)
        places = []
        for _ in range(8):
            run(simulated, 0.25)
            places.append(simulated.moment().target)
            assert simulated.moment().visible.all(), mode
        assert np.ptp(places, axis=0).max() > 0.05
        assert simulated.settled_s is None


def test_a_target_at_rest_follows_one_that_wandered():
    simulated = SimulatedHead(SETUP, mode="wander")
    run(simulated, 1.0)
    simulated.set_mode("by hand")
    here = simulated.target
    run(simulated, 1.0)
    assert simulated.target == pytest.approx(here)
    assert (simulated.moment().errors_px < 1.0).all()


def test_the_same_head_goes_on_from_its_posture_with_another_loop():
    simulated = SimulatedHead(SETUP)
    simulated.move_target(np.array([0.2, -0.1, 0.8]))
    run(simulated, 1.0)
    before = simulated.moment()
    simulated.change(Setup(head=SETUP.head, plant="mujoco", loop={"latency_s": 0.2}))
    after = simulated.moment()
    assert after.positions == pytest.approx(before.positions, abs=1e-9)
    assert after.target == pytest.approx(before.target, abs=1e-9)


def test_what_is_not_possible_changes_nothing():
    simulated = SimulatedHead(SETUP)
    with pytest.raises(ConfigurationError, match="latency_s"):
        simulated.change(Setup(head=SETUP.head, plant="kinematic", loop={"latency_s": -1.0}))
    assert simulated.setup == SETUP
    run(simulated, 0.1)


def test_time_goes_on_over_changes_of_head_and_law():
    simulated = SimulatedHead(SETUP)
    run(simulated, 0.2)
    simulated.change(Setup(head=load_head("icub"), plant="kinematic", controller="ibvs"))
    run(simulated, 0.2)
    assert simulated.moment().time_s == pytest.approx(0.4, abs=0.02)
    assert simulated.setup.head.name == "icub"


def test_a_target_anywhere_leaves_the_head_running():
    simulated = SimulatedHead(Setup(head=SETUP.head, plant="rendered"))
    for point in ([0.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -2.0], [9e9, 0, 1]):
        simulated.move_target(np.array(point))
        run(simulated, 0.1)
        assert np.isfinite(simulated.moment().positions).all(), point


def test_nothing_has_settled_that_did_not_move():
    simulated = SimulatedHead(SETUP, mode="by hand")
    run(simulated, 1.0)
    before = simulated.settled_s
    simulated.change(Setup(head=SETUP.head, plant="kinematic", controller="ibvs"))
    simulated.move_target(simulated.target)
    run(simulated, 0.5)
    assert simulated.settled_s == before
    simulated.change(Setup(head=SETUP.head, plant="mujoco", controller="ibvs"))
    run(simulated, 0.5)
    assert simulated.settled_s is None


@pytest.mark.slow
def test_a_point_of_the_room_is_looked_at_where_somebody_clicks():
    seen = {"look": "point", "scene": "room"}
    head = SimulatedHead(Setup(head=load_head("turrets"), seen=seen), "by hand")
    head.look_at(0, np.array([420.0, 300.0]))
    for _ in range(150):
        head.step()
    moment = head.moment()
    assert moment.visible.all()
    assert moment.errors_px.max() < 1.0
    assert not moment.shows_tag
    with pytest.raises(ConfigurationError, match="expected a wall to stand still"):
        head.set_mode("circle")
