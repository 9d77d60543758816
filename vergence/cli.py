"""The command line: parses, calls, says what went wrong."""

import io
import os
import sys
from contextlib import redirect_stderr
from typing import Protocol, get_args

import tyro

from vergence._jit import kernels_are_cached
from vergence.commands import Command
from vergence.commands.console import note
from vergence.errors import UnknownNameError, VergenceError


def main(arguments: list[str] | None = None) -> None:
    """Run the command line; exit code 0 for success, 1 for a gaze without a fix, 2 for misuse.

    Args:
        arguments: the words after the program's name; None for those of the process.
    """
    command = _parse(arguments)
    if not kernels_are_cached():
        note("compiling kernels, once after installation (about 20 s)")
    try:
        code = command.run()
    except VergenceError as error:
        note(f"error: {error}")
        code = 2
    except BrokenPipeError:
        # the reader of a pipe has gone: nothing is left to say, not even at exit
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        code = 0
    except KeyboardInterrupt:
        note("interrupted: nothing was written")
        code = 130
    sys.exit(code)


class _Runs(Protocol):
    def run(self) -> int:
        """Run the command and return its exit code."""


def _parse(arguments: list[str] | None) -> _Runs:
    """The command that the words ask for; words that make none end in one line on stderr."""
    _refuse_unknown(sys.argv[1:] if arguments is None else arguments)
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
            note(f"error: {_first_statement(said.getvalue())} (see vergence --help)")
        raise


def _refuse_unknown(words: list[str]) -> None:
    """A first word that is no command ends in one line that names the commands."""
    names = [get_args(command)[1].name for command in get_args(Command)]
    if words and not words[0].startswith("-") and words[0] not in names:
        note(f"error: {UnknownNameError('command', words[0], names)}")
        raise SystemExit(2)


def _first_statement(box: str) -> str:
    """What tyro says first in its frame, which goes on with help that --help shows as well."""
    lines = [line.strip("│╭╮╰╯ ") for line in box.splitlines()]
    inside = [line for line in lines[1:] if line]
    end = next((i for i, line in enumerate(inside) if not line.strip("─")), len(inside))
    return " ".join(inside[:end]) or " ".join(lines)
