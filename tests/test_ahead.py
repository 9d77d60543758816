"""Kernels are compiled in a second process only where nothing is cached and it has a processor."""

import gc
import sys
import weakref

import pytest

from tests.naming import named
from vergence import _ahead
from vergence.commands.gaze import COMPILED_AHEAD
from vergence.envs import judging, task
from vergence.envs.plants.stepping import StepArrays


@pytest.fixture
def started(monkeypatch, tmp_path):
    """The words of the processes that would be started, with an empty cache and two processors."""
    commands = []
    monkeypatch.setattr(_ahead.subprocess, "Popen", lambda words, **_rest: commands.append(words))
    monkeypatch.setattr(_ahead, "cache_folder", lambda: tmp_path)
    monkeypatch.setattr(_ahead, "any_compiled", lambda: any(tmp_path.iterdir()))
    monkeypatch.setattr(_ahead, "_processors", lambda: 2)
    return commands


def test_what_a_gaze_has_compiled_ahead_is_there():
    for name in COMPILED_AHEAD:
        with named(name):
            assert callable(_ahead.compiler_of(name))


def test_what_judges_a_step_is_compiled_for_the_types_of_a_real_one(monkeypatch):
    tables = []
    monkeypatch.setattr(judging, "advance_task", lambda table, *_rest: tables.append(table))
    judging.compile_step_result()
    trials = task.GazeTask(3, head="physical", plant="kinematic")
    compiled = [tables[0].dtype[i] for i in range(2)]
    place = StepArrays._fields.index
    assert compiled == [trials.plant._table.dtype[place(name)] for name in ("task", "reading")]


def test_an_empty_cache_is_filled_by_two_processes(started):
    _ahead.compile_in_background(["a:b"])
    assert started == [[sys.executable, "-m", "vergence._ahead", "a:b"]]


def test_a_process_that_still_runs_is_kept_for_python_warns_of_one_that_is_not(
    started, monkeypatch
):
    class Running:
        pass

    kept = []

    def start(_words, **_options):
        process = Running()
        kept.append(weakref.ref(process))
        return process

    monkeypatch.setattr(_ahead.subprocess, "Popen", start)
    _ahead.compile_in_background(["a:b"])
    gc.collect()
    assert kept[0]() is not None


def test_what_is_cached_is_not_compiled_again(started, tmp_path):
    (tmp_path / "kernel.nbi").touch()
    _ahead.compile_in_background(["a:b"])
    assert started == []


def test_one_processor_compiles_in_one_process(started, monkeypatch):
    monkeypatch.setattr(_ahead, "_processors", lambda: 1)
    _ahead.compile_in_background(["a:b"])
    assert started == []


def test_without_a_place_for_the_cache_there_is_nothing_to_share(started, monkeypatch):
    monkeypatch.setattr(_ahead, "cache_folder", lambda: None)
    _ahead.compile_in_background(["a:b"])
    assert started == []


def test_a_process_that_cannot_be_started_is_done_without(started, monkeypatch):
    def refuse(*_words, **_options):
        raise OSError("no more processes")

    monkeypatch.setattr(_ahead.subprocess, "Popen", refuse)
    _ahead.compile_in_background(["a:b"])
