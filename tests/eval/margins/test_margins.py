"""Margins of controllers: known ones, their rows, and their run folder."""

import json
import tomllib

import pandas as pd
import pytest

from tests.eval.mappers import Backwards
from tests.eval.refusals import not_refused
from tests.eval.trials.toys import AFTER, BEFORE, PERIOD_S, KnowsTheWay, ideal_head
from vergence.envs.plants.conditions import IMPERFECTIONS
from vergence.errors import ConfigurationError, UserControllerError
from vergence.eval.margins.report import report_tables, write_margins
from vergence.eval.margins.run import (
    BISECTIONS,
    GRID_FRACTIONS,
    IMPERFECTION_RANGES,
    MARGIN_ROW_FIELDS,
    Margins,
    MarginsConfig,
    measure_margins,
)
from vergence.reporting.report import SECTION_FILE, read_section


@pytest.fixture
def measured(known):
    def measure(
        *imperfections: str, keep_going: bool = False, episodes: int = 4, **toys: object
    ) -> Margins:
        config = MarginsConfig(scenarios=("known",), episodes=episodes, imperfections=imperfections)
        return measure_margins(config, toys, keep_going=keep_going)

    return measure


def fineness(name: str, share: float) -> float:
    """Largest shortfall of a search from the limit, on one side of the expected value."""
    following = min(one for one in GRID_FRACTIONS if one > share)
    last = max((0.0, *(one for one in GRID_FRACTIONS if one <= share)))
    span = IMPERFECTION_RANGES[name].highest - IMPERFECTION_RANGES[name].lowest
    return (following - last) / 2**BISECTIONS * span


def test_the_range_of_a_gain_is_what_the_band_allows(measured):
    head = ideal_head()
    off = head.project(head.fixate(BEFORE), AFTER) - head.cameras.principal
    first_px = max(float((one @ one) ** 0.5) for one in off)
    (row,) = measured("speed_gain", toy=KnowsTheWay(20)).rows()
    # turned by the gain's share too far, the error is that share of the first one
    room = 1.0 / first_px
    for end, limit in (("settles_low", 1.0 - room), ("settles_high", 1.0 + room)):
        short = (limit - row[end]) * (1.0 if limit > 1.0 else -1.0)
        # the perspective bends a little within the turn
        assert -0.05 * room <= short <= fineness("speed_gain", room / 0.6) + 0.05 * room
    assert (row["doubles_low"], row["doubles_high"]) == (row["settles_low"], row["settles_high"])


def test_the_median_has_doubled_once_the_commands_are_as_late_as_the_trial_was_long(measured):
    (row,) = measured("command_latency_s", toy=KnowsTheWay(5)).rows()
    # settled after 6 periods; 6 more are too many, and a part of one counts as all of it
    limit = 5 * PERIOD_S
    assert 0.0 <= limit - row["doubles_high"] <= fineness("command_latency_s", limit / 0.1)
    assert row["doubles_low"] == 0.0
    assert row["settles_high"] == IMPERFECTION_RANGES["command_latency_s"].highest


def test_a_controller_that_settles_nowhere_has_no_range(measured):
    margins = measured("command_latency_s", toy=KnowsTheWay(5, never=tuple(range(4))))
    (row,) = margins.rows()
    assert all(row[end] is None for end in MARGIN_ROW_FIELDS[4:])
    (table,) = report_tables(margins)
    assert table.rows[0][-2:] == ["nowhere", "nowhere"]
    assert "0 of 4 trials settle untouched" in table.title


@pytest.mark.nightly
def test_a_higher_gain_bears_less_delay():
    config = MarginsConfig(controllers=("ibvs",), episodes=1, imperfections=("latency_s",))
    one, other = (
        measure_margins(config, options={"ibvs": {"gain": gain}}).rows()[0]["settles_high"]
        for gain in (4.0, 8.0)
    )
    assert 0.0667 < other < one


def coarse(monkeypatch):
    monkeypatch.setattr("vergence.eval.margins.run.BISECTIONS", 1)
    monkeypatch.setattr("vergence.eval.margins.run.GRID_FRACTIONS", (0.5, 1.0))


@pytest.mark.nightly
def test_every_imperfection_is_moved_by_default_but_sizes_of_what_never_happens(
    measured, known, monkeypatch
):
    coarse(monkeypatch)
    known(duration_s=0.1)
    margins = measured(toy=KnowsTheWay(5), episodes=1)
    moved = [name for name in IMPERFECTION_RANGES if not IMPERFECTIONS[name].probability]
    assert [row["imperfection"] for row in margins.rows()] == moved
    for one in margins.margins:
        low, high = one.settles_low, one.settles_high
        assert low is not None
        assert high is not None
        assert one.range.low <= low <= one.range.expected <= high <= one.range.high
        # the ends have been measured, and were good
        good = {point.value for point in one.points if point.settles}
        assert {low, high} <= good


@pytest.mark.slow
def test_an_open_end_is_that_of_the_search_and_no_limit_of_what_can_be(measured):
    margins = measured("lag_s", "frame_phase", "command_latency_s", toy=KnowsTheWay(20))
    by_name = {one.imperfection: one for one in margins.margins}
    assert by_name["command_latency_s"].is_open("settles_high")
    assert not by_name["command_latency_s"].is_open("settles_low")
    assert not by_name["frame_phase"].is_open("settles_high")
    cells = {row[0]: row[3] for row in report_tables(margins)[0].rows}
    assert cells["command latency (ms)"] == "0 to ≥ 100"
    assert cells["camera phase (of a frame)"] == "0 to 1"


@pytest.mark.usefixtures("undrawn")
@pytest.mark.nightly
def test_the_run_folder_is_what_strict_readers_and_reports_can_read(measured, tmp_path):
    margins = measured(
        "command_latency_s", "speed_gain", toy=KnowsTheWay(5),
        never=KnowsTheWay(5, never=tuple(range(4))),
    )  # fmt: skip
    folder = tmp_path / "run"
    folder.mkdir()
    write_margins(folder, margins)

    def refuse(constant: str) -> None:
        raise AssertionError(constant)

    rows = json.loads((folder / "margins.json").read_text(), parse_constant=refuse)
    assert rows == margins.rows()
    assert all(
        list(row) == ["controller", "scenario", "imperfection", "unit", "settles_low",
                      "settles_high", "doubles_low", "doubles_high"]
        for row in rows
    )  # fmt: skip
    assert [(row["controller"], row["imperfection"], row["unit"]) for row in rows] == [
        ("toy", "command_latency_s", "s"), ("toy", "speed_gain", "1"),
        ("never", "command_latency_s", "s"), ("never", "speed_gain", "1"),
    ]  # fmt: skip
    table = pd.read_csv(folder / "margins.csv")
    assert table["searched_high"].tolist() == [0.1, 1.6, 0.1, 1.6]
    points = pd.read_csv(folder / "points.csv")
    assert len(points) == sum(len(one.points) for one in margins.margins)
    config = tomllib.loads((folder / "config.toml").read_text())
    assert config["config"]["episodes"] == 4
    assert "known" in config["heads"]
    section = read_section(folder / SECTION_FILE)
    assert [figure.name for figure in section.figures] == ["margins-known.svg"]
    assert (folder / "figures" / "margins-known.png").is_file()
    assert "command latency" in (folder / "report.html").read_text()


@pytest.mark.slow
def test_jobs_find_the_same_elsewhere_and_who_was_not_asked_for_does_not_run(monkeypatch):
    coarse(monkeypatch)
    names = ("frame_phase",)
    config = MarginsConfig(controllers=("ibvs",), episodes=1, imperfections=names)
    rows = measure_margins(config).rows()
    assert [row["controller"] for row in rows] == ["ibvs"]
    assert rows == measure_margins(config, mapper=Backwards()).rows()


class Tires(KnowsTheWay):
    calls = 0

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        self.calls += 1
        if self.calls == 300:
            raise ZeroDivisionError("tired")
        return super().predict(observation, state, episode_start, deterministic)


@pytest.mark.slow
def test_a_controller_that_raises_is_left_out_and_named(measured):
    margins = measured("frame_phase", keep_going=True, mine=Tires(5), toy=KnowsTheWay(5))
    assert [row["controller"] for row in margins.rows()] == ["toy"]
    (failure,) = margins.failures
    assert "controller mine: predict, call 300" in failure
    assert "tired" in failure
    with pytest.raises(UserControllerError, match="tired"):
        measured("frame_phase", mine=Tires(5))
    with pytest.raises(UserControllerError, match="tired"):
        measured("frame_phase", keep_going=True, mine=Tires(5))


def test_what_a_plant_cannot_have_is_left_out_with_a_note():
    config = MarginsConfig(
        controllers=("ibvs",), plants=("rendered",), episodes=1,
        imperfections=("detection_noise_px",),
    )  # fmt: skip
    with pytest.raises(ConfigurationError, match="imperfection: expected one that rendered can"):
        measure_margins(config)


def test_what_cannot_be_measured_is_refused_before_any_trial(monkeypatch):
    monkeypatch.setattr("vergence.eval.comparison.evaluate.run_trials", None)
    cases = [
        ({"imperfections": ("delay",)}, "imperfection: .*latency_s.*'delay'"),
        ({"scenarios": ("fast",)}, "scenario: .*never comes to rest"),
        ({"scenarios": ("moon",)}, "moon"),
        ({"plants": ("kinematic", "mujoco")}, "plant: expected one with"),
        ({"plants": ()}, "plant: expected one with --margins, got none"),
        ({"episodes": 0}, "episodes: expected at least 1, got 0"),
        ({"imperfections": ("outlier_px",)}, "imperfection: expected one"),
    ]

    def attempt(options):
        measure_margins(MarginsConfig(**{"controllers": ("ibvs",), **options}))

    assert not_refused(attempt, cases) == []
