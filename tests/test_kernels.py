"""Kernels broadcast, compile when called, follow changed sources, and need no writable folder."""

import ast
import errno
import os
import pickle
import platform
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from numba.core.caching import IndexDataCacheFile

from tests.rooms import sources_of
from vergence import kernels
from vergence.kernels import cache, jit, make_tuple_reader
from vergence.models.kinematics import Pose, direction_to_outer
from vergence.triangulation.rays import triangulate

HELPER = "from heads.kernels import jit\n\n@jit.inlined\ndef scale(x):\n    return {factor} * x\n"
KERNELS = """
from heads.kernels import jit
from heads.helper import scale

@jit.kernel(["void(float64[:], float64[:])"], "(n)->(n)")
def scaled(x, out):
    for i in range(x.shape[0]):
        out[i] = scale(x[i])

@jit.compiled
def ratio(a, b):
    return a / b

@jit.compiled
def inverse(x):
    return ratio(1.0, scale(x))
"""
PRINT = "from heads.loops import *; print(scaled([1.0, 2.0]), inverse(2.0), inverse(0.0))"
OTHERS = """
from heads.kernels import jit

@jit.compiled
def apart(x):
    return x + 1.0
"""
WATCH = """
import fcntl
from heads.kernels import cache, jit

class Watched(jit._GufuncBuilder):
    def build_ufunc(self):
        with open(cache.cache_folder() / "heads.loops.scaled.lock", "w") as file:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                print("alone", end=" ")
        return super().build_ufunc()

jit._GufuncBuilder = Watched
from heads.loops import scaled
print(scaled([1.0]))
"""


@pytest.fixture
def package(tmp_path):
    """A package of its own, with the same way to compile and a helper outside the kernel's file."""
    folder = tmp_path / "heads"
    folder.mkdir()
    (folder / "__init__.py").touch()
    (folder / "kernels").mkdir()
    for path in Path(jit.__file__).parent.glob("*.py"):
        text = path.read_text().replace("vergence.kernels", "heads.kernels")
        (folder / "kernels" / path.name).write_text(text)
    (folder / "helper.py").write_text(HELPER.format(factor=2.0))
    (folder / "loops.py").write_text(KERNELS)
    (folder / "others.py").write_text(OTHERS)
    return folder


def run(package: Path, code: str = PRINT, **environment: str) -> str:
    inherited = {
        name: value
        for name, value in os.environ.items()
        if name not in ("NUMBA_CACHE_DIR", "XDG_CACHE_HOME")
    }
    # No byte code, as Python itself may miss an edit that keeps a file's size within one second.
    inherited["PYTHONDONTWRITEBYTECODE"] = "1"
    result = subprocess.run(
        [sys.executable, "-c", code],
        cwd=package.parent,
        env=inherited | environment,
        capture_output=True,
        text=True,
    )
    assert result.returncode == 0, result.stderr
    return result.stdout.strip()


def compiled_files(folder: Path) -> set[Path]:
    return set(folder.rglob("*.nbc"))


def test_a_kernel_broadcasts_and_takes_an_output():
    @jit.kernel(["void(float64[:], float64[:], float64[:])"], "(n),(n)->()")
    def dot(a, b, out):
        out[0] = 0.0
        for i in range(a.shape[0]):
            out[0] += a[i] * b[i]

    a, b = np.arange(6.0).reshape(2, 1, 3), np.arange(12.0).reshape(4, 3)
    out = np.empty((2, 4))
    assert dot(a, b, out=out) is out
    np.testing.assert_allclose(out, (a * b).sum(-1), rtol=1e-15)


def said_by_a_call() -> list[str]:
    """Reports while a generalized ufunc and a function are called that nothing has compiled yet."""

    @jit.kernel(["void(float64[:], float64[:])"], "(n)->(n)")
    def doubled(x, out):
        for i in range(x.shape[0]):
            out[i] = 2.0 * x[i]

    @jit.compiled
    def halved(x):
        return 0.5 * x

    said: list[str] = []
    cache.set_compile_reporter(said.append)
    try:
        assert doubled([1.0, 2.0]).tolist() == [2.0, 4.0]
        assert halved(1.0) == 0.5
    finally:
        cache.set_compile_reporter(None)
    return said


def test_a_kernel_is_pickled_by_its_name():
    assert pickle.loads(pickle.dumps(triangulate)) is triangulate


def test_a_device_called_from_python_runs_as_python():
    pose = tuple(float(i) for i in range(12))
    assert direction_to_outer(Pose(*pose), 1.0, 0.0, 0.0) == (0.0, 4.0, 8.0)


@pytest.mark.slow
def test_compiling_is_said_once_and_not_when_it_is_kept(monkeypatch, tmp_path):
    monkeypatch.setattr(cache, "cache_folder", lambda: tmp_path)
    (first,) = said_by_a_call()
    assert first.startswith("compiling kernels")
    assert ", once" in first
    assert said_by_a_call() == []


@pytest.mark.slow
def test_compiling_at_every_call_is_said_with_its_reason_and_once_for_workers(monkeypatch):
    monkeypatch.setattr(cache, "cache_folder", lambda: None)
    for _call in range(2):
        (text,) = said_by_a_call()
        assert "at every call, as no folder to keep them in can be written" in text
        assert "NUMBA_CACHE_DIR" in text
    said: list[str] = []
    cache.set_compile_reporter(said.append)
    cache.report_compiling_if_uncached()
    cache.report_compiling_if_uncached()
    cache.set_compile_reporter(None)
    assert said == [text]


def test_a_full_disk_costs_the_cache_and_not_the_result(monkeypatch, tmp_path):
    def save(*arguments):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(cache, "cache_folder", lambda: tmp_path)
    monkeypatch.setattr(IndexDataCacheFile, "save", save)
    compiling, kept = said_by_a_call()
    assert compiling.startswith("compiling kernels")
    assert kept == "compiled kernels cannot be kept for the next call: No space left on device"
    assert not compiled_files(tmp_path)


def test_a_cache_that_cannot_be_read_is_done_without(monkeypatch, tmp_path):
    def load(*arguments):
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))

    monkeypatch.setattr(cache, "cache_folder", lambda: tmp_path)
    monkeypatch.setattr(IndexDataCacheFile, "load", load)
    assert said_by_a_call()


@pytest.mark.slow
@pytest.mark.parametrize("damaged", [".nbi", ".nbc"])
def test_a_damaged_cache_is_compiled_again_once(monkeypatch, tmp_path, damaged):
    monkeypatch.setattr(cache, "cache_folder", lambda: tmp_path)
    assert said_by_a_call()
    for path in tmp_path.rglob(f"*{damaged}"):
        path.write_bytes(path.read_bytes()[:10])
    assert said_by_a_call()
    assert said_by_a_call() == []


@pytest.mark.slow
def test_kernels_are_compiled_once_and_follow_the_sources_that_they_import(package):
    def apart():
        return {path for path in compiled_files(package) if "others" in str(path)}

    code = f"{PRINT}; import heads.others; heads.others.apart(1.0)"
    assert run(package, code) == "[2. 4.] 0.25 inf"
    first, others = compiled_files(package), apart()
    assert len(first) > len(others) == 1
    times = {path: path.stat().st_mtime_ns for path in first}
    assert run(package, code) == "[2. 4.] 0.25 inf"
    assert {path: path.stat().st_mtime_ns for path in compiled_files(package)} == times
    (package / "helper.py").write_text(HELPER.format(factor=4.0))
    assert run(package, code) == "[4. 8.] 0.125 inf"
    assert first & compiled_files(package) == apart() == others  # nothing old is kept, nor lost
    with (package / "kernels" / "jit.py").open("a") as compiler:
        compiler.write("_OPTIMISATION = 2\n")
    run(package, code)
    assert not others & compiled_files(package)


@pytest.mark.slow
def test_kernels_take_functions_and_constants_from_modules_that_their_digest_has():
    sources = sources_of(cache._PACKAGE)
    stale = []
    for module, path in sources.items():
        tree = ast.parse(path.read_text(encoding="utf-8"))
        imports = [node for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)]
        origins = {name.asname or name.name: at.module for at in imports for name in at.names}
        for function in ast.walk(tree):
            if isinstance(function, ast.FunctionDef) and any(
                set(kernels.__all__) & set(re.findall(r"\w+", ast.unparse(each)))
                for each in function.decorator_list
            ):
                inside = [node for part in function.body for node in ast.walk(part)]
                used = {origins.get(getattr(node, "id", None)) for node in inside} & set(sources)
                stale += [
                    f"{module}.{function.name}: {origin}"
                    for origin in used
                    if b"vergence.kernels" not in sources[origin].read_bytes()
                ]
    assert stale == [], "import from a module that names vergence.kernels, or name it there"


def test_the_first_folder_that_can_be_written_keeps_the_kernels(monkeypatch, tmp_path):
    package, chosen, home = tmp_path / "package", tmp_path / "chosen", tmp_path / "home"
    package.mkdir()
    monkeypatch.setattr(cache, "_PACKAGE", package)
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(chosen))
    monkeypatch.setenv("HOME", str(home))
    found = cache.cache_folder.__wrapped__
    assert found().parent == chosen
    monkeypatch.delenv("NUMBA_CACHE_DIR")
    assert found().parent == package / "__pycache__"
    (package / "__pycache__" / found().name).rmdir()
    (package / "__pycache__").rmdir()
    (package / "__pycache__").touch()  # a file here: not even root can make the folder
    assert found().parent == home / ".cache" / "vergence"
    monkeypatch.setenv("HOME", str(package / "__pycache__"))
    assert found() is None


@pytest.mark.nightly
def test_shipped_kernels_are_used_where_they_fit_and_nowhere_else(package, tmp_path):
    processor, features = cache.PORTABLE_PROCESSORS[platform.machine()]
    made = run(
        package,
        NUMBA_CACHE_DIR=str(tmp_path / "made"),
        NUMBA_CPU_NAME=processor,
        NUMBA_CPU_FEATURES=features,
    )
    (compiled,) = (tmp_path / "made").iterdir()
    place = "from heads.kernels import cache; print(cache.SHIPPED / cache.shipped_name())"
    shutil.copytree(compiled, run(package, place))
    assert run(package, NUMBA_CACHE_DIR=str(tmp_path / "first")) == made
    assert not compiled_files(tmp_path / "first")
    older = "from heads.kernels import cache as kept; kept.get_host_cpu_features = dict; " + PRINT
    assert run(package, older, NUMBA_CACHE_DIR=str(tmp_path / "second")) == made
    assert compiled_files(tmp_path / "second") or platform.machine() not in ("x86_64", "AMD64")
    (package / "helper.py").write_text(HELPER.format(factor=4.0))
    assert run(package, NUMBA_CACHE_DIR=str(tmp_path / "third")) == "[4. 8.] 0.125 inf"


@pytest.mark.nightly
def test_other_packages_keep_their_own_cache_setting(package):
    code = "import numba; from heads.loops import scaled; print(repr(numba.config.CACHE_DIR))"
    assert run(package, code) == "''"


@pytest.mark.nightly
def test_one_process_at_a_time_compiles_a_kernel(package):
    """Two at once may leave a wrapper that calls the other's loop by a name it does not have."""
    pytest.importorskip("fcntl", reason="no locks of this kind here")
    assert run(package, WATCH) == "alone [2.]"
    assert run(package, WATCH) == "alone [2.]"  # what is on disk is read alone too


_three = make_tuple_reader(3)


@jit.kernel(["void(float32[:], float32[:])", "void(float64[:], float64[:])"], "(n)->(n)")
def _shifted(row, out):
    run = _three(row, len(row) - 3)
    out[0], out[1], out[2] = run[0], run[1], run[2]


def test_a_run_of_numbers_is_read_at_once_from_arrays_of_any_layout():
    table = np.arange(24.0).reshape(4, 6)
    assert _shifted(table.copy())[:, :3].tolist() == table[:, 3:].tolist()
    assert _shifted(table.T[:4].T)[:, :3].tolist() == table[:, 1:4].tolist()
    assert _shifted(table[:, ::-2].astype(np.float32))[2, :3].tolist() == [17.0, 15.0, 13.0]
    assert _three(np.arange(9.0), 4) == (4.0, 5.0, 6.0)  # in Python as in a kernel
