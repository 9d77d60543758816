"""Controls of the simulated head show what is simulated, whatever browsers ask for."""

import asyncio
from types import SimpleNamespace

import numpy as np
import pytest

from vergence.models.head_file import load_head

pytest.importorskip("viser")

import viser

from vergence.viewer.playground import Playground
from vergence.viewer.simulated import Setup


@pytest.fixture
def playground(served):
    setup = Setup(head=load_head("simulated"), plant="kinematic", controller="ibvs")
    return Playground(served, setup, mode="by hand")


def run(playground, rounds=8):
    left = iter(range(rounds))
    playground.run(until=lambda: next(left, None) is None)


@pytest.mark.slow
def test_what_is_asked_is_done_between_two_periods(playground):
    playground.ask(lambda: playground._change(controller="pid"))
    playground.ask(lambda: playground._change_head("icub"))
    run(playground)
    setup = playground.simulated.setup
    assert (setup.head.name, setup.controller) == ("icub", "pid")
    assert (playground._head.value, playground._law.value) == ("icub", "pid")
    assert playground.view.shown >= 1


def test_all_that_a_slider_passes_on_its_way_is_done_at_once(playground, monkeypatch):
    made = []
    change = playground.simulated.change
    monkeypatch.setattr(playground.simulated, "change", lambda one: (made.append(one), change(one)))
    for milliseconds in range(40, 140):
        playground.ask(lambda ms=milliseconds: playground._change_loop("latency_s", ms))
    run(playground)
    assert [one.loop for one in made] == [{"latency_s": 0.139}]
    assert playground._sliders["latency_s"].value == pytest.approx(139.0)


@pytest.mark.slow
def test_what_is_not_possible_sets_the_controls_back(playground):
    before = playground.simulated.setup
    playground._sliders["latency_s"].value = -5.0
    playground.ask(lambda: playground._change_loop("latency_s", -5.0))
    run(playground)
    assert playground.simulated.setup == before
    assert playground._sliders["latency_s"].value == pytest.approx(
        1e3 * before.head.timing.latency_s, rel=1e-3
    )


@pytest.mark.slow
def test_a_target_that_is_dragged_upwards_rises(playground):
    handles, before = playground.view.scene.target, playground.simulated.target
    run(playground)
    dragged = SimpleNamespace(position=np.array(handles.position) + [0.0, 0.0, 0.1])
    asyncio.run(playground._drag(SimpleNamespace(phase="end", target=dragged)))
    run(playground)
    # y of N points down
    assert playground.simulated.target - before == pytest.approx([0.0, -0.1, 0.0], abs=1e-6)


@pytest.mark.slow
def test_a_click_in_an_eyes_picture_moves_the_target_there(playground):
    before = playground.simulated.target
    run(playground)
    screen = playground.view.scene._screens[1]
    turn = viser.transforms.SO3(np.array(screen.wxyz)).as_matrix()
    place = np.array(screen.position) + 0.25 * screen.render_width * turn[:, 0]
    away = turn @ [0.1, -0.2, 1.0]
    for on_click in screen._impl.click_cb:
        on_click.callback(
            SimpleNamespace(
                ray_origin=tuple(place - away), ray_direction=tuple(away), target=screen
            )
        )
    run(playground)
    moved = playground.simulated.target
    seen = playground.simulated.setup.head.project(playground.simulated.setup.head.rest(), moved)
    assert np.linalg.norm(moved - before) > 0.05
    assert playground.simulated.mode == "by hand"
    assert np.abs(seen[1] - [0.75 * 1040.0, 430.0]).max() < 40.0  # the eyes have begun to turn
