"""Parse the words of a command line into a command, or report in one line why they are wrong."""

import io
import re
import sys
from contextlib import redirect_stderr, redirect_stdout, suppress
from itertools import dropwhile, takewhile
from typing import Final, Protocol

import tyro

from vergence.commands import Command
from vergence.commands.console import print_to_stderr
from vergence.errors import ConfigurationError, UnknownNameError, did_you_mean


class Runnable(Protocol):
    """A command with its options."""

    def run(self) -> int:
        """Run the command and return its exit code."""


def parse_command(words: list[str]) -> Runnable:
    """Parse words into a command; `SystemExit` 0 after help, version; 2 for none or wrong ones."""
    if words == ["--version"]:
        from vergence import __version__

        print(f"vergence {__version__}")
        raise SystemExit(0)
    if not words:
        with redirect_stdout(sys.stderr), suppress(SystemExit):
            _call(["--help"])
        raise SystemExit(2)
    words = _with_axes_joined(_with_point(words))
    parser_output = io.StringIO()
    try:
        with redirect_stderr(parser_output):
            return _call(words)
    except SystemExit as stop:
        if stop.code == 2:
            path, commands = _command_of(words)
            reason = _reason(parser_output.getvalue(), path, commands, words[len(path) :])
            print_to_stderr(f"error: {reason} (see {' '.join(['vergence', *path])} --help)")
        raise


def split_verbosity(words: list[str]) -> tuple[list[str], int]:
    """Other words, and the number of -v, -vv and --verbose among them, at any position."""
    asked = [word for word in words if re.fullmatch(r"-v+|--verbose", word)]
    others = [word for word in words if word not in asked]
    return others, sum(1 if word == "--verbose" else len(word) - 1 for word in asked)


def _call(words: list[str]) -> Runnable:
    command: Runnable = tyro.cli(
        Command,
        prog="vergence",
        description=(
            "Active binocular vision for robot heads. `--version` prints the version; `-v` or "
            "`--verbose` reports on standard error what happens, `-vv` in detail."
        ),
        args=words,
        config=(tyro.conf.DisallowNone,),
    )
    return command


def _help(path: list[str]) -> str:
    parser_output = io.StringIO()
    with redirect_stdout(parser_output), suppress(SystemExit):
        _call([*path, "--help"])
    return parser_output.getvalue()


_NEGATIVE_AXES_PATTERN: Final = re.compile(r"-[xyz](,[+-]?[xyz]){2}")
"""Pattern of a value that looks like an option: camera axes whose first axis is negative."""


def _with_point(words: list[str]) -> list[str]:
    """Words in which a position given by its first name, --target, is given as --point."""
    if words[0] not in ("gaze", "emulate") or "--target" not in words:
        return words
    place = words.index("--target")
    given = words[place + 1] if place + 1 < len(words) else ""
    with suppress(ValueError):
        float(given)
        print_to_stderr("--target: it is --point now; --target is accepted until version 0.2")
        return [*words[:place], "--point", *words[place + 1 :]]
    if words[0] == "gaze":
        return words
    raise ConfigurationError(
        f"--target: expected the position of the target, as --point X Y Z in mm, got {given!r}: "
        "an emulated head shows a tag there, or with --scene a ball or a poster in a room"
    )


def _with_axes_joined(words: list[str]) -> list[str]:
    """Words with such values joined to their option by "=", as the parser needs them."""
    joined: list[str] = []
    for word in words:
        if joined and joined[-1] == "--camera-axes" and _NEGATIVE_AXES_PATTERN.fullmatch(word):
            joined[-1] += f"={word}"
        else:
            joined.append(word)
    return joined


def _command_of(words: list[str]) -> tuple[list[str], list[str]]:
    """Leading (sub)commands of words, and the subcommands one of which has to follow."""
    path: list[str] = []
    while True:
        choice = re.match(r"usage: [^{]*\[-h\] \{([^}]+)\}", _help(path))
        names = re.split(r",\s*", choice[1]) if choice else []
        following = words[len(path) : len(path) + 1]
        if not following or following[0] not in names:
            return path, names
        path += following


def _reason(parser_output: str, path: list[str], commands: list[str], words: list[str]) -> str:
    """Reason why words are not a valid command."""
    if commands:
        if words and not words[0].startswith("-"):
            return str(UnknownNameError("command", words[0], commands))
        return f"command: expected one of {', '.join(commands)}"
    options = sorted(set(re.findall(r"(?<![\w-])--[a-z][\w-]*", _help(path))))
    for word in words:
        option = word.partition("=")[0].replace("_", "-")
        if re.match("--[a-z]", option) and option not in options:
            return f"{option}: no option of {' '.join(path)}{did_you_mean(option, options)}"
    return _reworded_error(_first_statement(parser_output), parser_output, words)


_TYPE_NAMES: Final = {"INT": "a whole number", "FLOAT": "a number"}


def _reworded_error(statement: str, parser_output: str, words: list[str]) -> str:
    """First error of the parser, reworded without Python types and internal names."""
    if statement.startswith("Missing from "):
        each = [one.split() for one in statement.partition(": ")[2].split("(required)")[:-1]]
        missing = [
            " ".join(one[:2] if one[0].startswith("--") else one[:1]).rstrip(",") for one in each
        ]
        return f"missing {', '.join(missing)}"
    if few := re.match(r"Missing value for argument '(\S+)'\. Expected (\d+)", statement):
        name = few[1].rpartition(".")[2]
        return f"{name}: expected {few[2]} value{'' if few[2] == '1' else 's'}, got fewer"
    if choice := re.match(r"invalid choice '(.*)' for argument '(\S+)'.*\((.*)\)", statement):
        known = [name for name in sorted(re.findall(r"'([^']*)'", choice[3])) if name != "None"]
        return str(UnknownNameError(choice[2], choice[1], known))
    shown = re.search(r"Argument helptext:[\s│]*(--\S+) ([^\n│,]*)", parser_output)
    if statement.startswith("Error parsing --") and shown:
        option, metavar = shown[1], shown[2].strip()
        given = _values(words, statement.split()[2].rstrip(":").split("/"), len(metavar.split()))
        return f"{option}: expected {_TYPE_NAMES.get(metavar, f'numbers {metavar}')}, got {given}"
    return statement + _size_hint(statement, words)


def _values(words: list[str], options: list[str], count: int) -> str:
    """Values given to an option at its last occurrence, quoted."""
    for place, word in reversed(list(enumerate(words))):
        option, equals, value = word.partition("=")
        if option in options:
            return " ".join(map(repr, [value] if equals else words[place + 1 : place + 1 + count]))
    return "another"


def _size_hint(statement: str, words: list[str]) -> str:
    """Hint for a size that was given as two numbers instead of one word."""
    if statement.startswith("Unrecognized options: "):
        for option, first, second in zip(words, words[1:], words[2:], strict=False):
            if option == "--size" and first.isdecimal() and second.isdecimal():
                return f"; a size is one word: {option} {first}x{second}"
    return ""


def _first_statement(parser_output: str) -> str:
    """First error in tyro's framed output, without the help texts that follow it."""
    lines = [line.strip("│╭╮╰╯ ") for line in parser_output.splitlines()]
    # skip the title, which is followed by a rule if the frame is in ASCII
    inside = list(dropwhile(_is_rule, (line for line in lines[1:] if line)))
    return " ".join(takewhile(lambda line: not _is_rule(line), inside)) or " ".join(lines)


def _is_rule(line: str) -> bool:
    return not line.strip("─-")
