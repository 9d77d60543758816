"""Files and folders appear whole or not at all, by one process at a time; nothing stays behind."""

import errno
import os
import stat
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import pytest
from filelock import FileLock

from tests.naming import refused
from vergence.files import (
    PARTIAL_PREFIX,
    SUFFIX,
    atomic_file,
    atomic_files,
    atomic_folder,
    hold_lock,
    remove_partial,
    save_folder_at_free_path,
    write_atomic,
)


def names(folder) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_text_and_bytes_are_written_as_they_are_with_the_permissions_of_any_file(tmp_path):
    for content, stored in (("é\n", "é\n".encode()), (b"\x00\xff", b"\x00\xff")):
        write_atomic(tmp_path / "file", content)
        assert (tmp_path / "file").read_bytes() == stored
    assert names(tmp_path) == ["file"]
    (tmp_path / "usual").touch()
    usual, file = (stat.S_IMODE((tmp_path / name).stat().st_mode) for name in ("usual", "file"))
    assert file == usual


def test_a_failure_leaves_the_former_file_or_folder(tmp_path):
    write_atomic(tmp_path / "file", "before")
    with pytest.raises(TypeError), atomic_file(tmp_path / "file") as partial:
        partial.write_text(b"no text" if partial.name == "file" else "")
    assert (tmp_path / "file").read_text() == "before"
    with atomic_folder(tmp_path / "run") as folder:
        (folder / "one").touch()
    with pytest.raises(FileNotFoundError), atomic_folder(tmp_path / "run") as folder:
        (folder / "missing" / "two").touch()
    with pytest.raises(OSError, match="not empty"), atomic_folder(tmp_path / "run") as folder:
        (folder / "two").touch()
    assert names(tmp_path) == ["file", "run"]
    assert names(tmp_path / "run") == ["one"]


def test_the_last_of_several_files_comes_last(tmp_path, monkeypatch):
    order = []
    replace = os.replace

    def noted(source, target):
        order.append(os.path.basename(target))
        replace(source, target)

    monkeypatch.setattr(os, "replace", noted)
    with atomic_files(tmp_path, moved_last="a.json") as folder:
        for name in ("a.json", "b.csv", "c.csv"):
            (folder / name).write_text(name)
    assert order == ["b.csv", "c.csv", "a.json"]
    assert names(tmp_path) == sorted(order)


def test_a_folder_replaces_the_former_one_whole_or_gives_it_its_place_back(tmp_path, monkeypatch):
    for content in ("one", "two"):
        with atomic_folder(tmp_path / "deep" / "run", replace=True) as folder:
            (folder / content).touch()
        assert names(tmp_path / "deep") == ["run"]
        assert names(tmp_path / "deep" / "run") == [content]
    replace = os.replace

    def fail_once(source, target) -> None:
        if os.path.basename(source) == "new":
            raise PermissionError(source)
        replace(source, target)

    monkeypatch.setattr(os, "replace", fail_once)
    with pytest.raises(PermissionError), atomic_folder(tmp_path / "deep/run", replace=True):
        pass
    assert names(tmp_path / "deep" / "run") == ["two"]


def write_mine(folder) -> None:
    (folder / "mine").touch()


def test_a_folder_is_saved_under_its_name_which_an_empty_one_makes_free(tmp_path):
    for there in (False, True):
        place = tmp_path / f"deep{there}" / "run"
        if there:
            place.mkdir(parents=True)
        assert save_folder_at_free_path(place, write_mine) == place
        assert names(place.parent) == ["run"]
        assert names(place) == ["mine"]


def fill(folder) -> None:
    folder.mkdir()
    (folder / "theirs").touch()


@pytest.mark.parametrize("take", [fill, Path.touch, lambda path: path.symlink_to("nowhere")])
def test_a_folder_whose_name_is_taken_meanwhile_is_saved_beside_it(tmp_path, take):
    def write(folder) -> None:
        write_mine(folder)
        for name in ("run", "run-2"):
            take(tmp_path / name)

    assert save_folder_at_free_path(tmp_path / "run", write) == tmp_path / "run-3"
    assert names(tmp_path) == ["run", "run-2", "run-3"]
    assert names(tmp_path / "run-3") == ["mine"]


def test_a_folder_that_can_be_saved_nowhere_fails_once(tmp_path, monkeypatch):
    fill(tmp_path / "run")

    def refuse(_source, target) -> None:
        raise PermissionError(13, "Permission denied", target)

    monkeypatch.setattr(os, "replace", refuse)
    with pytest.raises(PermissionError, match="run-2"):
        save_folder_at_free_path(tmp_path / "run", write_mine)
    assert names(tmp_path) == ["run"]
    assert names(tmp_path / "run") == ["theirs"]


def test_an_error_names_no_hidden_place_but_the_users_own(tmp_path):
    with pytest.raises(OSError, match="No space") as full, atomic_file(tmp_path / "file"):
        raise OSError(errno.ENOSPC, "No space left on device")
    assert full.value.filename == str(tmp_path)
    assert names(tmp_path) == []
    (tmp_path / "folder").mkdir()
    with pytest.raises(OSError, match="directory") as taken:
        write_atomic(tmp_path / "folder", "text")
    assert taken.value.filename == str(tmp_path / "folder")


def test_what_a_kill_left_of_one_folder_is_removed_and_nothing_of_others(tmp_path):
    (tmp_path / "kept").touch()
    for name in ("mine", "another"):
        with atomic_folder(tmp_path / name) as partial:
            (tmp_path / f"{partial.parent.name}left").mkdir()
    (tmp_path / f"{PARTIAL_PREFIX}x").mkdir()
    remove_partial(tmp_path, "mine")
    assert len(names(tmp_path)) == 5
    remove_partial(tmp_path)
    assert names(tmp_path) == ["another", "kept", "mine"]


def lock(place: Path) -> None:
    with hold_lock(place):
        pass


def test_a_second_lock_is_refused_told_who_writes_where_and_has_the_place_after_a_kill(tmp_path):
    code = (
        "import sys, time; from vergence.files import hold_lock\n"
        f"with hold_lock({str(tmp_path / 'run')!r}): print('held', flush=True); sys.stdin.read()"
    )
    holder = subprocess.Popen(
        [sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert holder.stdout.readline() == "held\n"
    refused(f"{tmp_path / 'run'}, to which process {holder.pid} is writing", lock, tmp_path / "run")
    holder.kill()
    holder.communicate()
    assert names(tmp_path) == [f".run{SUFFIX}"]  # what a kill leaves behind locks nothing
    lock(tmp_path / "run")
    assert names(tmp_path) == []


def test_nothing_of_a_lock_stays_but_parents_that_something_has_come_into(tmp_path):
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
        refused("writing", lock, tmp_path / "link")


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
