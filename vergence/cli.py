"""The command line: parse the arguments, run the command, report errors."""

import os
import re
import sys
import traceback
import warnings
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

from vergence import interrupts
from vergence.commands.console import logging_to_stderr, print_to_stderr, replace_unprintable
from vergence.commands.parsing import parse_command, split_verbosity
from vergence.errors import ConfigurationError, HardwareError, VergenceError, VergenceWarning
from vergence.viewer.opengl import disable_broken_opengl

TRACE_VARIABLE: Final = "VERGENCE_TRACE"
"""Environment variable; if set, a bug of the package shows its stack trace."""
_PACKAGE: Final = Path(__file__).parent


def main(arguments: list[str] | None = None) -> None:
    """Run the command line with the arguments, or with the process's own.

    The exit code is 0 for success; 1 for a gaze without a fix, images without a target, or a robot
    that fails; 2 for misuse (also for no arguments, which print the help) and for files that cannot
    be read or written; and 130 after Ctrl-C.
    """
    replace_unprintable()
    interrupts.raise_on_interrupt()
    code = _outcome(sys.argv[1:] if arguments is None else arguments)
    interrupts.ignore_interrupts()
    sys.exit(code)


def _outcome(arguments: list[str]) -> int:
    """Run a command and report errors, one line each; return the exit code."""
    try:
        code = _run(arguments)
        for stream in (sys.stdout, sys.stderr):
            if stream is not None:
                stream.flush()
        return code
    except VergenceError as error:
        return _fail(*error.lines, code=1 if isinstance(error, HardwareError) else 2)
    except BrokenPipeError:
        _give_up_stdout()  # the reader of a pipe has gone: print nothing more, not even at exit
        return 0
    except (KeyboardInterrupt, Exception) as error:
        # a library may convert Ctrl-C to an error of its own
        if isinstance(error, KeyboardInterrupt) or interrupts.interrupted:
            said = str(error) if isinstance(error, KeyboardInterrupt) else ""
            print_to_stderr(f"interrupted: {said}" if said else interrupts.NOTHING_WRITTEN)
            return 130
        if isinstance(error, OSError):
            reason = error.strerror or str(error) or type(error).__name__
            file = "" if error.filename is None else f"{os.fsdecode(error.filename)}: "
            return _fail(file + reason)
        if isinstance(error, MemoryError):
            return _fail("expected more memory than this machine has to spare")
        if os.environ.get(TRACE_VARIABLE):
            raise
        frames = traceback.extract_tb(error.__traceback__)
        own = [frame for frame in frames if _PACKAGE in Path(frame.filename).parents]
        place = f"{Path(own[-1].filename).relative_to(_PACKAGE)}:{own[-1].lineno}"
        return _fail(
            f"unexpected {type(error).__name__} at {place}: {error} (a fault of vergence itself: "
            f"please report it; {TRACE_VARIABLE}=1 shows the whole trace)"
        )


def _run(arguments: list[str]) -> int:
    for word in arguments:
        # surrogates stand for bytes that the terminal's encoding does not have
        if re.search("[\0\ud800-\udfff]", word):
            raise ConfigurationError(f"expected words of text in UTF-8, got {word!r}")
    words, verbosity = split_verbosity(arguments)
    command = parse_command(words)
    warnings.showwarning = _show_warning
    opengl = disable_broken_opengl()
    if opengl is not None:
        print_to_stderr(f"going on without OpenGL, as it does not work with {opengl}")
    _tell_of_kernels()
    with logging_to_stderr(verbosity):
        return command.run()


def _show_warning(
    message: Warning | str, category: type[Warning], *place: Any, **_options: Any
) -> None:
    """Show the package's own warnings in one line each, and others as Python does."""
    if issubclass(category, VergenceWarning):
        print_to_stderr(f"warning: {message}")
    elif sys.stderr is not None:
        print(warnings.formatwarning(message, category, *place[:2]), file=sys.stderr)


def _tell_of_kernels() -> None:
    from vergence.kernels import cache  # it loads numba, which a help text does not need

    cache.set_compile_reporter(print_to_stderr)


def _fail(*reasons: str, code: int = 2) -> int:
    for reason in reasons:
        print_to_stderr(reason if reason.startswith("warning: ") else f"error: {reason}")
    try:
        if sys.stdout is not None:
            sys.stdout.flush()
    except OSError:  # such as a full disk behind it
        _give_up_stdout()
    return code


def _give_up_stdout() -> None:
    """Redirect standard output to nothing, so that Python's flush at exit does not fail."""
    with suppress(OSError, ValueError):  # a stream without a file behind it
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
