"""One process at a time writes to a place, and nothing of a lock stays behind."""

import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import pytest
from filelock import FileLock

from vergence.errors import ConfigurationError
from vergence.files import SUFFIX, hold_lock


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def take(place: Path) -> None:
    with hold_lock(place):
        pass


def test_a_second_one_is_refused_told_who_writes_where_and_has_the_place_after_a_kill(tmp_path):
    code = (
        "import sys, time; from vergence.files import hold_lock\n"
        f"with hold_lock({str(tmp_path / 'run')!r}): print('held', flush=True); sys.stdin.read()"
    )
    holder = subprocess.Popen(
        [sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert holder.stdout.readline() == "held\n"
    with pytest.raises(ConfigurationError, match=f"process {holder.pid}") as refused:
        take(tmp_path / "run")
    assert str(tmp_path / "run") in str(refused.value)
    holder.kill()
    holder.communicate()
    assert names(tmp_path) == [f".run{SUFFIX}"]  # what a kill leaves behind locks nothing
    take(tmp_path / "run")
    assert names(tmp_path) == []


def test_nothing_stays_behind_but_parents_that_something_has_come_into(tmp_path):
    place = tmp_path / "new" / "deep" / "run"
    with suppress(KeyError), hold_lock(place):
        assert names(tmp_path) == ["new"]
        raise KeyError
    assert names(tmp_path) == []
    with hold_lock(place):
        place.mkdir()
    assert names(place.parent) == ["run"]


def test_two_names_of_one_place_have_one_lock_and_its_neighbour_another(tmp_path):
    (tmp_path / "link").symlink_to(tmp_path / "run")
    with hold_lock(tmp_path / "run") as first, hold_lock(tmp_path / "two") as second:
        assert (first, second) == (True, True)
        with pytest.raises(ConfigurationError, match="writing"):
            take(tmp_path / "link")


def test_the_next_one_never_holds_a_lock_whose_file_has_been_removed(tmp_path):
    with hold_lock(tmp_path / "run"):
        (tmp_path / f".run{SUFFIX}").unlink()
        with hold_lock(tmp_path / "run"):
            assert names(tmp_path) == [f".run{SUFFIX}"]
    assert names(tmp_path) == []


def test_where_no_lock_can_be_made_the_work_goes_on(tmp_path, monkeypatch):
    with hold_lock(tmp_path / ("x" * 255)) as alone:  # too long a name for that of a lock
        assert not alone

    def refuse(*_args: object, **_options: object) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(FileLock, "acquire", refuse)
    with hold_lock(tmp_path / "run") as alone:
        assert not alone
    assert names(tmp_path) == []
