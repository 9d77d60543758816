"""Environment of every test: one thread per process, no window, reproducible examples in CI."""

import gc
import os

# Set before NumPy or torch is imported, here and in the workers that inherit it: the workers share
# the cores already, and more threads would only take them from one another.
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("MPLBACKEND", "Agg")
os.environ.setdefault("SDL_VIDEODRIVER", "dummy")
os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")
os.environ["VERGENCE_TRACE"] = "1"  # a fault of the package fails a test with its trace
# Never the real one: fixtures of a module run before those of its tests, see `user_table`.
os.environ["VERGENCE_TUNED"] = os.path.join(os.sep, "no-such-folder", "tuned.toml")

from contextlib import contextmanager
from pathlib import Path

import pytest
from _pytest.runner import runtestprotocol
from hypothesis import settings

# No deadline: the first example of a property may compile a kernel.
settings.register_profile("vergence", deadline=None, derandomize=bool(os.environ.get("CI")))
settings.load_profile("vergence")


@pytest.fixture(autouse=True)
def user_table(monkeypatch, tmp_path_factory):
    """The user's table of tuned options: a place of its own for each test, with nothing there."""
    path = tmp_path_factory.getbasetemp() / f"user-{os.urandom(6).hex()}" / "tuned.toml"
    monkeypatch.setenv("VERGENCE_TUNED", str(path))
    return path


@contextmanager
def sketched():
    """Figures are empty: drawing them takes longer than all else where a test looks elsewhere."""
    from matplotlib.figure import Figure

    def save(_figure, place, **_options):
        write = getattr(place, "write", None) or Path(place).write_text
        write("<svg viewBox='0 0 1 1'></svg>")

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Figure, "draw_without_rendering", lambda _figure: None)
        patch.setattr(Figure, "savefig", save)
        yield patch


@pytest.fixture
def undrawn():
    """See `sketched`."""
    with sketched() as patch:
        yield patch


@pytest.fixture(autouse=True)
def silent_kernels(monkeypatch):
    """Commands do not say that kernels are compiled, which depends on what has run before."""
    monkeypatch.setattr("vergence.cli._tell_of_kernels", lambda: None)


def pytest_collection_modifyitems(items):
    """Begin with the top folder's tests, which take longest: the last ones are then short."""
    items.sort(key=lambda item: len(item.path.parts))


def pytest_collection_finish():
    """Spare the searches for cyclic garbage all that was imported and lives until the end."""
    gc.collect()
    gc.freeze()


QUICK_S = 2.0
"""Longest that a test may take that no marker calls slow (chosen: six times what is usual)."""
UNHURRIED = frozenset({"slow", "nightly", "real_time", "flaky"})


def _waited_s():
    """Time for which this process was ready to run and had no core, s; 0 where none tells."""
    try:
        return 1e-9 * int(Path("/proc/self/schedstat").read_text().split()[1])
    except OSError:
        return 0.0


def pytest_runtest_protocol(item, nextitem):
    """Run a test without a marker again if it took long, and fail it if it does so twice.

    The first time may have compiled a kernel or imported a library. Fixtures do not count, nor does
    the time in which other processes had the cores.
    """
    if UNHURRIED.intersection(mark.name for mark in item.iter_markers()):
        return None
    item.ihook.pytest_runtest_logstart(nodeid=item.nodeid, location=item.location)
    took_s = []
    while len(took_s) < 2:
        before_s = _waited_s()
        reports = runtestprotocol(item, nextitem=nextitem, log=False)
        call = next((one for one in reports if one.when == "call" and one.passed), None)
        if call is None or call.duration - (_waited_s() - before_s) <= QUICK_S:
            break
        took_s.append(call.duration)
        item._initrequest()  # new fixtures
    else:
        call.outcome = "failed"
        call.longrepr = (
            f"expected at most {QUICK_S:g} s, got {took_s[0]:.1f} s and {took_s[1]:.1f} s: "
            "make it quicker, or mark it slow or nightly, see CONTRIBUTING.md"
        )
    for report in reports:
        item.ihook.pytest_runtest_logreport(report=report)
    item.ihook.pytest_runtest_logfinish(nodeid=item.nodeid, location=item.location)
    return True
