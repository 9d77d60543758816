"""Handle Ctrl-C while the command line starts, runs and ends: one line and exit code 130.

Only a process that was started as the command line is changed: a program that imports the package
keeps its own handling.
"""

import os
import signal
import sys
import threading
from _thread import interrupt_main
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from types import FrameType

NOTHING_WRITTEN = "interrupted: nothing was written"
_REPEAT_S = 0.05
"""Time after which a lost interruption is repeated, s (chosen: the callback has ended by then)."""

_ENDERS = [getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name)]
"""Signals other than Ctrl-C that end a process; Windows has only one of them."""

interrupted = False
"""True if Ctrl-C was pressed, even if a library has converted or ignored it."""
started_as_command = False  # True if this process was started as the command line


def end_quietly_on_interrupt() -> None:
    """Make Ctrl-C end the command line with one line; called at this module's import, the first."""
    global started_as_command
    program = sys.argv[0] if getattr(sys, "argv", None) else ""
    name, suffix = os.path.splitext(os.path.basename(program).lower())
    started_as_command = name == "vergence" and suffix in ("", ".exe")
    if program == "-m":  # `python -m` imports a module's package under this name
        words = sys.orig_argv
        module = words[words.index("-m") + 1] if "-m" in words[:-1] else ""
        started_as_command = module == "vergence" or "-mvergence" in words
    if started_as_command and signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        with suppress(ValueError):  # imported by another thread than the main one
            signal.signal(signal.SIGINT, _leave)


def raise_on_interrupt() -> None:
    """Make Ctrl-C raise `KeyboardInterrupt` from now on, and record it in `interrupted`."""
    if signal.getsignal(signal.SIGINT) is _leave:
        signal.signal(signal.SIGINT, _interrupt)
        sys.unraisablehook = _repeat_if_lost


def raise_on_termination() -> None:
    """Make SIGTERM and SIGHUP end the command line like Ctrl-C, so that the robot is stopped."""
    if started_as_command:
        for number in _ENDERS:
            if signal.getsignal(number) is signal.SIG_DFL:  # `nohup` ignores one of them
                signal.signal(number, _interrupt)


def ignore_interrupts() -> None:
    """Ignore Ctrl-C from now on: the command has ended and reported its result."""
    for number in _ENDERS:
        if signal.getsignal(number) is _interrupt:
            signal.signal(number, signal.SIG_DFL)
    if signal.getsignal(signal.SIGINT) is _interrupt:
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        # Python kills itself with the signal if the last code that it ran from text was
        # interrupted, such as a library's during its import; this runs such code undisturbed
        exec("pass")


@contextmanager
def postponed() -> Iterator[None]:
    """Keep Ctrl-C until the end of the context, for libraries that would lose it and be damaged."""
    answer = signal.getsignal(signal.SIGINT)
    if threading.current_thread() is not threading.main_thread() or not callable(answer):
        yield
        return
    came: list[tuple[int, FrameType | None]] = []
    signal.signal(signal.SIGINT, lambda *event: came.append(event))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, answer)
        if came:
            answer(*came[0])


def _leave(_number: int, _frame: object) -> None:
    os.write(2, f"vergence: {NOTHING_WRITTEN}\n".encode())
    os._exit(130)


def _interrupt(number: int, frame: object) -> None:
    global interrupted
    interrupted = True
    raise KeyboardInterrupt


def _repeat_if_lost(lost: "sys.UnraisableHookArgs") -> None:
    """Interrupt again if Python cannot pass an interruption on from a callback or finaliser."""
    if lost.exc_type is not KeyboardInterrupt:
        sys.__unraisablehook__(lost)
        return
    to_main = getattr(signal, "pthread_kill", lambda *_: interrupt_main())  # Windows has none
    again = threading.Timer(_REPEAT_S, to_main, (threading.main_thread().ident, signal.SIGINT))
    again.daemon = True
    again.start()


end_quietly_on_interrupt()
