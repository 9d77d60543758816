"""The command line: parses, calls, says what went wrong."""

import io
import os
import re
import sys
import traceback
from contextlib import redirect_stderr, suppress
from itertools import dropwhile, takewhile
from pathlib import Path
from typing import Final, Protocol, get_args

import tyro

from vergence import _jit, interrupts
from vergence.commands import Command
from vergence.commands.console import make_printable, note
from vergence.envs.opengl import switch_off_what_fails
from vergence.errors import ConfigurationError, UnknownNameError, VergenceError

TRACE_VARIABLE: Final = "VERGENCE_TRACE"
"""The environment variable with which a fault of the package shows its stack trace."""
_PACKAGE: Final = Path(__file__).parent


def main(arguments: list[str] | None = None) -> None:
    """Run the command line.

    The exit code is 0 for success, 1 for a gaze without a fix and for images
    without a target, 2 for misuse and for what could
    not be read or written, and 130 after Ctrl-C.

    Args:
        arguments: the words after the program's name; None for those of the process.
    """
    make_printable()
    interrupts.guard_run()
    code = _outcome(sys.argv[1:] if arguments is None else arguments)
    interrupts.guard_end()
    sys.exit(code)


def _outcome(arguments: list[str]) -> int:
    """Run a command and say in one line what went wrong; the exit code."""
    try:
        code = _run(arguments)
        for stream in (sys.stdout, sys.stderr):
            if stream is not None:
                stream.flush()
    except VergenceError as error:
        return _fail(str(error))
    except BrokenPipeError:
        _give_up_stdout()  # the reader of a pipe has gone: nothing is left to say, not even at exit
        return 0
    except KeyboardInterrupt as stop:
        return _end_interrupted(stop)
    except Exception as error:
        # a library may make an error of its own out of Ctrl-C
        if interrupts.interrupted():
            return _end_interrupted()
        if isinstance(error, OSError):
            return _fail(_reason(error))
        if isinstance(error, MemoryError):
            return _fail("expected more memory than this machine has to spare")
        if os.environ.get(TRACE_VARIABLE):
            raise
        return _fail(_fault(error))
    return code


def _run(arguments: list[str]) -> int:
    for word in arguments:
        if "\0" in word or not _is_text(word):
            raise ConfigurationError(f"expected words of text in UTF-8, got {word!r}")
    command = _parse(arguments)
    opengl = switch_off_what_fails()
    if opengl is not None:
        note(f"going on without OpenGL, as it does not work with {opengl}")
    _tell_of_kernels()
    return command.run()


def _tell_of_kernels() -> None:
    _jit.report_to(note)


def _is_text(word: str) -> bool:
    try:
        word.encode()
    except UnicodeEncodeError:  # bytes that the terminal's encoding does not have
        return False
    return True


def _fail(reason: str) -> int:
    note(f"error: {reason}")
    try:
        if sys.stdout is not None:
            sys.stdout.flush()
    except OSError:  # such as a full disk behind it
        _give_up_stdout()
    return 2


def _reason(error: OSError) -> str:
    """What the system says, with the file that it is about."""
    reason = error.strerror or str(error) or type(error).__name__
    return reason if error.filename is None else f"{os.fsdecode(error.filename)}: {reason}"


def _fault(error: Exception) -> str:
    """What went wrong in the package itself, and where; no mistake of a user."""
    frames = traceback.extract_tb(error.__traceback__)
    own = [frame for frame in frames if _PACKAGE in Path(frame.filename).parents]
    place = f"{Path(own[-1].filename).relative_to(_PACKAGE)}:{own[-1].lineno}" if own else "unknown"
    return (
        f"unexpected {type(error).__name__} at {place}: {error} (a fault of vergence itself: "
        f"please report it; {TRACE_VARIABLE}=1 shows the whole trace)"
    )


def _end_interrupted(stop: KeyboardInterrupt | None = None) -> int:
    said = str(stop or "")
    note(f"interrupted: {said}" if said else interrupts.NOTHING_WRITTEN)
    return 130


def _give_up_stdout() -> None:
    """Let Python's own flush at exit go nowhere."""
    with suppress(OSError, ValueError):  # a stream without a file behind it
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


_AXES: Final = re.compile(r"-[xyz](,[+-]?[xyz]){2}")
"""A value that looks like an option: axes of a camera's frame, the first of them backwards."""


def _with_axes_joined(words: list[str]) -> list[str]:
    """The words with such values joined to their option, as the parser takes them."""
    joined: list[str] = []
    for word in words:
        if joined and joined[-1] == "--camera-axes" and _AXES.fullmatch(word):
            joined[-1] += f"={word}"
        else:
            joined.append(word)
    return joined


class _Runs(Protocol):
    def run(self) -> int:
        """Run the command and return its exit code."""


def _parse(arguments: list[str]) -> _Runs:
    """The command that the words ask for; words that make none end in one line on stderr."""
    _refuse_unknown(arguments)
    arguments = _with_axes_joined(arguments)
    said = io.StringIO()
    try:
        with redirect_stderr(said):
            command: _Runs = tyro.cli(
                Command,
                prog="vergence",
                description="Active binocular vision for robot heads.",
                args=arguments,
            )
            return command
    except SystemExit as stop:
        if stop.code == 2:
            statement = _first_statement(said.getvalue())
            note(f"error: {statement}{_one_word(statement, arguments)} (see vergence --help)")
        raise


def _one_word(statement: str, words: list[str]) -> str:
    """A hint where two numbers follow an option that takes one word, such as a size."""
    if statement.startswith("Unrecognized options: "):
        for option, first, second in zip(words, words[1:], words[2:], strict=False):
            if option == "--size" and first.isdecimal() and second.isdecimal():
                return f"; a size is one word: {option} {first}x{second}"
    return ""


def _refuse_unknown(words: list[str]) -> None:
    """A first word that is no command ends in one line that names the commands."""
    names = [get_args(command)[1].name for command in get_args(Command)]
    if words and not words[0].startswith("-") and words[0] not in names:
        raise UnknownNameError("command", words[0], names)


def _first_statement(box: str) -> str:
    """What tyro says first in its frame, which goes on with help that --help shows as well."""
    lines = [line.strip("│╭╮╰╯ ") for line in box.splitlines()]
    # below the title, which stands above a rule where the frame is in ASCII
    inside = list(dropwhile(_is_rule, (line for line in lines[1:] if line)))
    return " ".join(takewhile(lambda line: not _is_rule(line), inside)) or " ".join(lines)


def _is_rule(line: str) -> bool:
    return not line.strip("─-")
