"""Ctrl-C while the command line starts, runs and ends: one line and exit code 130.

Python answers with a stack trace of whatever it was importing, and some libraries turn the
interruption into an error of their own, or ignore it. Only a process that was started as the
command line is treated so: a program that imports the package keeps its own answer.
"""

import os
import signal
import sys
from contextlib import suppress

NOTHING_WRITTEN = "interrupted: nothing was written"

_seen = False
_guards = False  # whether this process was started as the command line


def guard_start() -> None:
    """From this module's import on, the package's first, Ctrl-C ends the command line in a line."""
    global _guards
    _guards = _is_command_line()
    if _guards and signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        with suppress(ValueError):  # imported by another thread than the main one
            signal.signal(signal.SIGINT, _leave)


def guard_run() -> None:
    """From here on Ctrl-C is a `KeyboardInterrupt`, which is remembered, see `interrupted`."""
    if signal.getsignal(signal.SIGINT) is _leave:
        signal.signal(signal.SIGINT, _interrupt)


def guard_robot() -> None:
    """From here on the command line ends by SIGTERM and SIGHUP as by Ctrl-C: a robot is stopped."""
    if _guards:
        for number in _enders():
            if signal.getsignal(number) is signal.SIG_DFL:  # `nohup` ignores one of them
                signal.signal(number, _interrupt)


def guard_end() -> None:
    """The command has ended and said how: Ctrl-C changes nothing any more."""
    for number in _enders():
        if signal.getsignal(number) is _interrupt:
            signal.signal(number, signal.SIG_DFL)
    if signal.getsignal(signal.SIGINT) is _interrupt:
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        # Python ends itself by the signal if the last code that it ran from text was interrupted,
        # such as a library's while it was imported; this here is such code, and is not
        exec("pass")


def _enders() -> list[signal.Signals]:
    """Signals besides Ctrl-C that end a process; Windows has one of them."""
    return [getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name)]


def interrupted() -> bool:
    """Whether Ctrl-C was pressed, whatever a library has made of it."""
    return _seen


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
    global _seen
    _seen = True
    raise KeyboardInterrupt


guard_start()
