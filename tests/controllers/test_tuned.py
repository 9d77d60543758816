"""Options kept as data, and the law that takes its gain from them."""

import re
import shlex
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import platformdirs
import pytest

from tests.naming import named, refused
from vergence import load_head, make_controller
from vergence.controllers import tuned
from vergence.errors import UnknownNameError
from vergence.eval.trials.scenarios import load_scenario


def entry(controller="ibvs", scenario="step", options=None, **changes) -> tuned.TunedEntry:
    fields = {"head": "mine", "digest": "d" * 64, "command": "vergence tune", "seed": 0}
    fields["options"] = {"gain": 4.2} if options is None else options
    return tuned.TunedEntry(controller=controller, scenario=scenario, **(fields | changes))


def other_head():
    head = load_head("simulated")
    return head.replace(name="mine", timing={"lag_s": 0.04})


def own_gain(head, gain=3.25, scenario="workspace") -> tuned.TunedEntry:
    options = {"gain": gain}
    return entry(scenario=scenario, options=options, head=head.name, digest=head.digest)


def test_what_is_written_is_read_back_and_the_rest_stays(tmp_path) -> None:
    path = tmp_path / "new" / "tuned.toml"
    step = entry(command="vergence tune ibvs", seed=3, plant="mujoco")
    options = {"kp": [[1.0, 2.0], [3.0, 4.0]], "depth": "triangulated", "n": np.float64(2.0)}
    tuned.write_tuned(path, step)
    tuned.write_tuned(path, entry("pid", "robust", options, provisional=True))
    tuned.write_tuned(path, entry("ibvs", "robust", {"gain": np.float32(0.5)}))
    table = tuned.load_tuned(path)
    assert table[step.key] == step
    assert table["ibvs", "robust", "d" * 64].options == {"gain": 0.5}
    assert table["pid", "robust", "d" * 64].options == {**options, "n": 2.0}
    assert table["pid", "robust", "d" * 64].provisional


def test_a_second_run_replaces_the_entry_of_the_same_head_and_leaves_anothers(tmp_path) -> None:
    path = tmp_path / "tuned.toml"
    tuned.write_tuned(path, entry(provisional=True))
    tuned.write_tuned(path, entry(digest="e" * 64))
    tuned.write_tuned(path, entry("ibvs-tuned", options={"gain": 4.1}, seed=1))
    left = (entry(options={"gain": 4.1}, seed=1), entry(digest="e" * 64))
    assert tuned.load_tuned(path) == {one.key: one for one in left}


@pytest.mark.slow
def test_processes_that_write_at_once_lose_no_entry(tmp_path) -> None:
    path = tmp_path / "tuned.toml"
    with ThreadPoolExecutor(8) as pool:
        list(pool.map(lambda n: tuned.write_tuned(path, entry(seed=n, digest=f"{n}")), range(24)))
    assert sorted(one.seed for one in tuned.load_tuned(path).values()) == list(range(24))


def test_options_that_are_no_plain_values_are_refused(tmp_path) -> None:
    for value in [np.nan, np.inf, None, {"a": 1.0}, object()]:
        with named(value):
            wrong = entry(options={"gain": value})
            refused(r"step\.gain: expected finite", tuned.write_tuned, tmp_path / "t.toml", wrong)
            assert not list(tmp_path.iterdir())


COMPLETE = "controller='c'\nscenario='s'\nhead='h'\ndigest='d'\ncommand='c'\noptions={}\n"


def test_a_file_that_is_no_table_is_refused_in_a_line_and_kept(tmp_path) -> None:
    for content, message in [
        ("tuned = 4.2", r"tuned: expected entries \[\[tuned\]\]"),
        ("tuned = [4.2]", r"entry 1: expected a table, got 4\.2"),
        ("[[tuned]]\noptions = {gain = 4.2}", "entry 1: expected controller, got none"),
        (f"[[tuned]]\n{COMPLETE}seed = 1.5", r"entry 1: seed: expected int, got 1\.5"),
        (f"[[tuned]]\n{COMPLETE}seed = 1\nsee = 2", "entry 1: expected .*, got 'see'"),
        ("[ibvs", "expected a TOML file"),
    ]:
        with named(content, message):
            path = tmp_path / "tuned.toml"
            path.write_text(content, encoding="utf-8")
            message = f"{re.escape(str(path))}.*{message}"
            refused(message, tuned.load_tuned, path)
            refused(message, tuned.write_tuned, path, entry())
            assert path.read_text(encoding="utf-8") == content
    refused("expected a table of tuned options", tuned.load_tuned, tmp_path / "none.toml")


def test_every_shipped_entry_makes_its_controller() -> None:
    head = load_head("simulated")
    table = tuned.load_tuned()
    there = {key.scenario for key in table if key.controller == "ibvs"}
    assert {"step", "workspace", "fast", "robust"} <= there
    for key, found in table.items():
        make_controller(key.controller, head=head, **found.options)


@pytest.mark.slow
def test_every_shipped_entry_is_for_the_head_that_its_command_names() -> None:
    """Run again, the command is for that head: one without --head for the scenario's own."""
    for key, found in tuned.load_tuned().items():
        words = shlex.split(found.command)
        assert words[:5] == ["vergence", "tune", key.controller, "--scenario", key.scenario]
        assert "--plant" not in words
        own = load_scenario(key.scenario).model()
        if "--head" in words:
            own = load_head(words[words.index("--head") + 1])
        assert (found.head, found.digest) == (own.name, own.digest), key


def test_the_tuned_law_is_the_law_with_the_tables_gain() -> None:
    for key, found in tuned.load_tuned().items():
        if key.controller != "ibvs":
            continue
        own = load_scenario(key.scenario).model()
        head = own if own.digest == found.digest else load_head(found.head)
        law = make_controller("ibvs-tuned", head=head, scenario=key.scenario)
        assert law.tuned
        assert np.all(law.gain == found.options["gain"])
        options = tuned.tuned_or_fallback_options("ibvs-tuned", key.scenario, head)
        assert np.array_equal(make_controller("ibvs-tuned", head=head, **options).gain, law.gain)


def test_the_users_options_come_before_the_packages_and_only_for_their_head(user_table) -> None:
    preset, mine = load_head("simulated"), other_head()
    tuned.write_tuned(user_table, own_gain(mine, 3.25))
    tuned.write_tuned(user_table, own_gain(preset, 4.05))
    for head, gain in ((mine, 3.25), (preset, 4.05)):
        assert tuned.tuned_or_fallback_options("ibvs-tuned", "workspace", head) == {"gain": gain}
        assert np.all(make_controller("ibvs-tuned", head=head).gain == gain)
    # another name is no other head
    twin = mine.replace(name="twin")
    assert tuned.tuned_or_fallback_options("ibvs-tuned", "workspace", twin) == {"gain": 3.25}


def test_a_head_without_options_starts_from_those_of_the_scenarios_head() -> None:
    head = other_head()
    found = tuned.find_tuned_or_fallback("pid", "workspace", head)
    assert found.head == "simulated"
    assert not tuned.is_tuned_for(found, head)
    law = make_controller("ibvs-tuned", head=head)
    assert not law.tuned
    assert np.array_equal(law.gain, make_controller("ibvs-tuned", load_head("simulated")).gain)


def test_the_users_table_lies_in_their_data_folder_or_as_a_variable_says(monkeypatch, tmp_path):
    monkeypatch.delenv("VERGENCE_TUNED")
    assert tuned.user_table_path() == platformdirs.user_data_path("vergence") / "tuned.toml"
    monkeypatch.setenv("VERGENCE_TUNED", str(tmp_path / "team.toml"))
    assert tuned.user_table_path() == tmp_path / "team.toml"
    assert not tuned.user_table_path().is_relative_to(tuned.TUNED_FILE.parent)


def test_a_users_table_that_is_damaged_or_without_the_gain_is_refused(user_table) -> None:
    head = load_head("simulated")
    tuned.write_tuned(user_table, replace(own_gain(head), options={}))
    refused("gain: expected finite gains", make_controller, "ibvs-tuned", head)
    user_table.write_text("[[tuned", encoding="utf-8")
    refused(re.escape(str(user_table)), make_controller, "ibvs-tuned", head)


def test_the_articles_law_and_where_nothing_was_found_have_no_options() -> None:
    head = load_head("simulated")
    for law, scenario in [("ibvs", "workspace"), ("ibvs-tuned", "nowhere"), ("nobody", "fast")]:
        assert tuned.tuned_or_fallback_options(law, scenario, head) == {}
    options = tuned.tuned_or_fallback_options("ibvs-tuned", "workspace", head)
    options["gain"] = 0.0  # a copy
    assert tuned.tuned_or_fallback_options("ibvs-tuned", "workspace", head)["gain"] > 0.0


def test_an_unknown_scenario_is_refused_with_the_known_ones() -> None:
    with pytest.raises(UnknownNameError, match=r"scenario: expected one of.*workspace.*'sofa'"):
        make_controller("ibvs-tuned", head=load_head("simulated"), scenario="sofa")
