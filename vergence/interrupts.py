"""Handle Ctrl-C while the command line starts, runs and ends: one line and exit code 130.

By default, Python prints a stack trace of the current import, and some libraries convert the
interruption to an error of their own, or ignore it. Only a process that was started as the command
line is changed: a program that imports the package keeps its own handling.
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

_interrupted = False
_started_as_command = False  # True if this process was started as the command line


def end_quietly_on_interrupt() -> None:
    """Make Ctrl-C end the command line with one line; called at this module's import, the first."""
    global _started_as_command
    _started_as_command = _is_command_line()
    if _started_as_command and signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        with suppress(ValueError):  # imported by another thread than the main one
            signal.signal(signal.SIGINT, _leave)


def raise_on_interrupt() -> None:
    """Make Ctrl-C raise `KeyboardInterrupt` from now on, and record it, see `was_interrupted`."""
    if signal.getsignal(signal.SIGINT) is _leave:
        signal.signal(signal.SIGINT, _interrupt)
        sys.unraisablehook = _repeat_if_lost


def raise_on_termination() -> None:
    """Make SIGTERM and SIGHUP end the command line like Ctrl-C, so that the robot is stopped."""
    if _started_as_command:
        for number in _enders():
            if signal.getsignal(number) is signal.SIG_DFL:  # `nohup` ignores one of them
                signal.signal(number, _interrupt)


def ignore_interrupts() -> None:
    """Ignore Ctrl-C from now on: the command has ended and reported its result."""
    for number in _enders():
        if signal.getsignal(number) is _interrupt:
            signal.signal(number, signal.SIG_DFL)
    if signal.getsignal(signal.SIGINT) is _interrupt:
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        # Python kills itself with the signal if the last code that it ran from text was
        # interrupted, such as a library's during its import; this runs such code undisturbed
        exec("pass")


def _enders() -> list[signal.Signals]:
    """Signals other than Ctrl-C that end a process; Windows has only one of them."""
    return [getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name)]


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


def was_interrupted() -> bool:
    """True if Ctrl-C was pressed, even if a library has converted or ignored it."""
    return _interrupted


def _is_command_line() -> bool:
    program = sys.argv[0] if getattr(sys, "argv", None) else ""
    if program == "-m":  # `python -m` imports a module's package under this name
        return "vergence" in sys.orig_argv or "-mvergence" in sys.orig_argv
    name, suffix = os.path.splitext(os.path.basename(program))
    return name.lower() == "vergence" and suffix.lower() in ("", ".exe")


def _leave(_number: int, _frame: object) -> None:
    os.write(2, f"vergence: {NOTHING_WRITTEN}\n".encode())
    os._exit(130)


def _interrupt(number: int, frame: object) -> None:
    global _interrupted
    _interrupted = True
    raise KeyboardInterrupt


def _repeat_if_lost(lost: "sys.UnraisableHookArgs") -> None:
    """Interrupt again if the first time was in a callback or finaliser, from where none gets out.

    Python calls it with each exception that it cannot pass on.
    """
    if lost.exc_type is KeyboardInterrupt:
        again = threading.Timer(_REPEAT_S, _interrupt_main_thread)
        again.daemon = True
        again.start()
    else:
        sys.__unraisablehook__(lost)


def _interrupt_main_thread() -> None:
    if hasattr(signal, "pthread_kill"):
        signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGINT)
    else:  # Windows
        interrupt_main()


end_quietly_on_interrupt()
