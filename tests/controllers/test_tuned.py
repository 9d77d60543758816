"""Options kept as data, and the law that takes its gain from them."""

import numpy as np
import pytest

from tests.controllers.loops import settle_time, true_errors
from vergence import load_head, make_controller
from vergence.controllers import tuned
from vergence.envs.task import GazeTask
from vergence.errors import ConfigurationError, UnknownNameError


def test_what_is_written_is_read_back_and_the_rest_stays(tmp_path) -> None:
    path = tmp_path / "tuned.toml"
    tuned.write_tuned(path, "ibvs", "step", {"gain": 4.2}, "vergence tune ibvs", 3)
    options = {"kp": [[1.0, 2.0], [3.0, 4.0]], "depth": "triangulated", "n": np.float64(2.0)}
    tuned.write_tuned(path, "pid", "robust", options, "by hand", 0, provisional=True)
    tuned.write_tuned(path, "ibvs", "robust", {"gain": np.float32(0.5)}, "vergence tune", 1)
    table = tuned.load_tuned(path)
    assert table["ibvs"]["step"] == tuned.Tuned(
        options={"gain": 4.2}, command="vergence tune ibvs", seed=3
    )
    assert table["ibvs"]["robust"].options == {"gain": 0.5}
    assert table["pid"]["robust"].options == {**options, "n": 2.0}
    assert table["pid"]["robust"].provisional
    assert [file.name for file in tmp_path.iterdir()] == ["tuned.toml"]


def test_a_second_run_replaces_the_entry_of_the_first(tmp_path) -> None:
    path = tmp_path / "tuned.toml"
    tuned.write_tuned(path, "ibvs", "step", {"gain": 4.2}, "a", 0, provisional=True)
    tuned.write_tuned(path, "ibvs-tuned", "step", {"gain": 4.1}, "b", 1)
    assert tuned.load_tuned(path) == {
        "ibvs": {"step": tuned.Tuned(options={"gain": 4.1}, command="b", seed=1)}
    }


@pytest.mark.parametrize("value", [np.nan, np.inf, None, {"a": 1.0}, object()])
def test_options_that_are_no_plain_values_are_refused(tmp_path, value) -> None:
    with pytest.raises(ConfigurationError, match=r"ibvs\.step\.gain: expected finite numbers"):
        tuned.write_tuned(tmp_path / "t.toml", "ibvs", "step", {"gain": value}, "c", 0)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("ibvs = 4.2", "ibvs: expected scenarios, got 4.2"),
        ("[ibvs.step]\noptions = {gain = 4.2}", r"ibvs\.step: expected options, command and seed"),
        (
            "[ibvs.step]\noptions = {}\ncommand = 'c'\nseed = 1.5",
            r"ibvs\.step: expected options, command and seed",
        ),
        ("[ibvs", "expected a TOML file"),
    ],
)
def test_a_file_that_is_no_table_is_refused(tmp_path, content, message) -> None:
    path = tmp_path / "tuned.toml"
    path.write_text(content, encoding="utf-8")
    with pytest.raises(ConfigurationError, match=message):
        tuned.load_tuned(path)


def test_a_missing_file_is_refused(tmp_path) -> None:
    with pytest.raises(ConfigurationError, match="expected a table of tuned options"):
        tuned.load_tuned(tmp_path / "none.toml")


def test_every_shipped_entry_makes_its_controller() -> None:
    head = load_head("simulated")
    table = tuned.load_tuned()
    assert {"step", "workspace", "fast", "robust"} <= table["ibvs"].keys()
    for name, entries in table.items():
        for entry in entries.values():
            make_controller(name, head=head, **entry.options)


def test_the_tuned_law_is_the_law_with_the_tables_gain() -> None:
    head = load_head("simulated")
    for scenario in tuned.load_tuned()["ibvs"]:
        law = make_controller("ibvs-tuned", head=head, scenario=scenario)
        assert np.all(law.gain == tuned.load_tuned()["ibvs"][scenario].options["gain"])
        options = tuned.tuned_options("ibvs-tuned", scenario)
        assert np.array_equal(make_controller("ibvs-tuned", head=head, **options).gain, law.gain)


def test_the_articles_law_keeps_its_gain() -> None:
    assert tuned.tuned_options("ibvs", "workspace") == {}


def test_where_nothing_was_found_there_are_no_options() -> None:
    assert tuned.tuned_options("ibvs-tuned", "nowhere") == {}
    assert tuned.tuned_options("nobody", "workspace") == {}


def test_options_are_a_copy() -> None:
    name, scenario = next(iter(tuned.load_tuned()["ibvs"].items()))
    first = tuned.tuned_options("ibvs-tuned", name)
    first["scenario"] = "other"
    assert tuned.tuned_options("ibvs-tuned", name) == {"scenario": name}
    assert scenario.options["gain"] > 0.0


def test_an_unknown_scenario_is_refused_with_the_known_ones() -> None:
    with pytest.raises(UnknownNameError, match=r"scenario: expected one of.*workspace.*'sofa'"):
        make_controller("ibvs-tuned", head=load_head("simulated"), scenario="sofa")


def test_the_tuned_gain_settles_the_step_sooner_than_the_articles() -> None:
    head = load_head("simulated").replace(sensor={"detection_noise_px": 0.0})
    times = []
    for name in ("ibvs", "ibvs-tuned"):
        task = GazeTask(1, head=head, plant="kinematic", target="step")
        options = tuned.tuned_options(name, "step")
        controller = make_controller(name, head=head, layout=task.layout, **options)
        times.append(settle_time(true_errors(task, controller, 2.0), 1 / 120))
    assert times[1] <= times[0]
