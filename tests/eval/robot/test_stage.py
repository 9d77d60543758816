"""Stages, which place targets before a robot: their choice, and the targets they can show."""

import dataclasses
import sys

import numpy as np
import pytest

from tests.hardware.line import desk_config
from vergence.errors import ConfigurationError
from vergence.eval.robot.stage import make_stage
from vergence.eval.trials.scenarios import load_scenario
from vergence.hardware.config import MeasuredTarget
from vergence.hardware.plant import HardwarePlant
from vergence.vision.targets import parse_target

PLACES = tuple(
    MeasuredTarget(
        target=parse_target(f"tag:36h11:{ident}:120"), point=np.array([0.1 * ident, 0.0, 1.0])
    )
    for ident in range(3)
)
DESK = desk_config("/dev/null")


def test_the_first_stage_that_is_there_is_chosen(monkeypatch):
    monkeypatch.setattr(sys.stdin, "isatty", lambda: True, raising=False)
    placed = dataclasses.replace(DESK, measured_targets=PLACES)
    emulated = dataclasses.replace(placed, emulator_address="127.0.0.1:1", places_targets=True)
    names = [type(make_stage(None, one)).__name__ for one in (emulated, placed, DESK)]
    assert names == ["EmulatorStage", "MeasuredTagsStage", "HandPlacedStage"]


def test_a_robot_that_nobody_watches_needs_to_be_told(monkeypatch):
    monkeypatch.setattr(sys.stdin, "isatty", lambda: False, raising=False)
    with pytest.raises(ConfigurationError, match="--stage still"):
        make_stage(None, DESK)
    with pytest.raises(ConfigurationError, match=r"expected tables \[\[places\]\] in robot.toml"):
        make_stage("places", DESK)


def test_places_take_turns_and_the_eyes_look_for_each(monkeypatch):
    looked = []
    monkeypatch.setattr(HardwarePlant, "look_for", lambda self, target: looked.append(target))
    plant = HardwarePlant.__new__(HardwarePlant)
    stage = make_stage("places", dataclasses.replace(DESK, measured_targets=PLACES), seed=2)
    points = [stage.place(plant, trial) for trial in range(4)]
    assert {one.id for one in looked[:3]} == {0, 1, 2}
    assert looked[3] is looked[0]
    assert [point[0] for point in points] == pytest.approx([0.1 * one.id for one in looked])
    desk = dataclasses.replace(DESK, measured_targets=PLACES)
    firsts = {make_stage("places", desk, seed=n).place(plant, 0)[0] for n in range(8)}
    assert len(firsts) > 1  # the seed's order


def test_a_place_that_the_eyes_cannot_look_at_is_refused():
    target = parse_target("tag:36h11:9:120")
    behind = (*PLACES, MeasuredTarget(target=target, point=np.array([0, 0, -1.0])))
    said = r"places\[3\]\.point_mm .* got \[0.0, 0.0, -1000.0\]"
    with pytest.raises(ConfigurationError, match=said):
        make_stage("places", dataclasses.replace(DESK, measured_targets=behind))


def test_a_robot_is_shown_no_target_that_moves():
    for name in ("fast", "double-step"):
        with pytest.raises(ConfigurationError, match="expected one whose target stands still"):
            make_stage("still", DESK).target(load_scenario(name))
