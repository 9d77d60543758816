"""Onset of the target or of its motion: nothing of it shows before."""

import numpy as np
import pytest

from tests.controllers.loops import begin
from tests.envs.trials import AHEAD, pixels_of, start_of, steps
from tests.naming import named
from vergence.envs.plant import make_plant, simulation_of
from vergence.envs.targets.motion import motion_rows, target_position
from vergence.envs.task import GazeTask

T = 1 / 120
ONSETS = np.array([0.0, 23 / 120, 0.1375, 0.4])


def test_nothing_is_seen_of_a_target_before_its_onset(exact) -> None:
    for plant_name in ["kinematic", "mujoco"]:
        with named(plant_name):
            plant = make_plant(plant_name, exact, 4, onset_s=ONSETS)
            readings, _q, _v = steps(plant, start_of(4), 80)
            for i, onset_s in enumerate(ONSETS):
                dates = np.array([reading.exposure_s[i] for reading in readings])
                seen = np.array([reading.visible[i].all() for reading in readings])
                assert np.array_equal(seen, dates > onset_s - 1e-9)
                first = np.ceil(onset_s / T - 1e-9) * T  # with cameras at the control rate
                assert dates[seen].min() == pytest.approx(first, abs=1e-9)


def test_a_target_that_jumps_stays_where_it_was_until_the_onset(exact) -> None:
    for plant_name in ["kinematic", "mujoco"]:
        with named(plant_name):
            before, after = (0.05, -0.1, 1.0), AHEAD
            plant = make_plant(plant_name, exact, 4, onset_s=ONSETS)
            readings, q, _v = steps(plant, start_of(4, after, before), 80)
            held, jumped = (exact.project(np.zeros(7), point) for point in (before, after))
            for reading in readings:
                assert reading.visible.all()
                for i, onset_s in enumerate(ONSETS):
                    expected = jumped if reading.exposure_s[i] > onset_s - 1e-9 else held
                    assert reading.pixels[i] == pytest.approx(expected, abs=1e-9)
            assert not q.any()
            assert np.abs(held - jumped).max() > 10.0


def test_the_truth_changes_at_the_onset_itself(exact) -> None:
    for plant_name in ["kinematic", "mujoco"]:
        with named(plant_name):
            before = (0.05, -0.1, 1.0)
            plant = make_plant(plant_name, exact, 4, onset_s=ONSETS)
            simulation_of(plant).begin(start_of(4, AHEAD, before))
            for step in range(60):
                # 23 periods are not 23 / 120 s to the last bit, but a little less
                there = step * T > ONSETS - 1e-9
                expected = np.where(there[:, None], AHEAD, before)
                assert simulation_of(plant).truth().target == pytest.approx(expected, abs=1e-12)
                plant.step(np.zeros((4, 7)))
            assert simulation_of(plant).onset_s() == pytest.approx(ONSETS, abs=1e-12)


def test_a_moving_targets_time_begins_at_the_onset(exact) -> None:
    onset_s = 0.137
    rows = motion_rows(np.array([AHEAD]), before=np.array([AHEAD]), velocity=(0.2, 0.0, 0.1))
    start = start_of()._replace(motions=rows)
    plant = make_plant("kinematic", exact, 1, onset_s=onset_s)
    readings, q, _v = steps(plant, start, 60)
    for reading in readings:
        point = target_position(rows, max(reading.exposure_s[0] - onset_s, 0.0))[0]
        expected = pixels_of(exact, q[0], q[0], point)
        assert reading.pixels == pytest.approx(expected, abs=1e-5)
    expected = target_position(rows, 60 * T - onset_s)
    assert plant.truth().target == pytest.approx(expected, abs=1e-9)


def test_every_kind_of_target_is_the_same_and_later() -> None:
    for kind in ("random", "static", "step", "circle", "orbit", "double-step"):
        with named(kind):
            prompt, late = (
                begin(GazeTask(6, plant="kinematic", target=kind, plant_options={"onset_s": after}))
                for after in (0.0, 0.25)
            )
            for _ in range(30):
                late.step(np.zeros((6, 4)))
            for _ in range(60):
                assert late.truth().target == pytest.approx(prompt.truth().target, abs=1e-9)
                for task in (prompt, late):
                    task.step(np.zeros((6, 4)))
