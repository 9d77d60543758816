"""Read a TOML table key by key, each value checked by a rule; write plain values as TOML."""

import re
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from difflib import get_close_matches
from typing import Any, Final, TypeVar

import numpy as np
import tomli_w

from vergence.errors import HeadFileError, UnquotedText
from vergence.models.parts import FloatArray

T = TypeVar("T")
Rule = tuple[Callable[[float], bool], str]
"""Predicate that accepts a number, and the description of accepted numbers for messages."""

_UNIT_QUESTION: Final = re.compile(r" \(is it in (\w+)\?\)$")
"""Question about the unit at the end of a rule's description."""
_UNIT_FACTORS: Final = {"degrees": np.pi / 180.0, "millimetres": 1e-3, "milliseconds": 1e-3}
"""Factor from the unit that a question asks about to the rule's own unit."""


class Table:
    """A TOML table consumed key by key, empty at the end; else `HeadFileError` names the key."""

    def __init__(self, values: object, path: str) -> None:
        if not isinstance(values, Mapping):
            raise HeadFileError(path, values, "a table")
        self._values = dict(values)
        self._path = path
        self._asked: set[str] = set()

    def key(self, name: str) -> str:
        """Dotted name of a key, for messages."""
        name = name if name.isprintable() else repr(name)  # a message is one line
        return f"{self._path}.{name}" if self._path else name

    def expect(self, fits: object, name: str, value: object, expected: str) -> None:
        """Refuse the value of a key unless it fits."""
        if not fits:
            raise HeadFileError(self.key(name), value, expected)

    def has(self, name: str) -> bool:
        """True if a key is present; marks it as known."""
        self._asked.add(name)
        return name in self._values

    def peek(self, name: str) -> Any:
        """Value of a key without consuming it; None if it is left out."""
        return self._values[name] if self.has(name) else None

    def take(self, name: str, expected: str) -> Any:
        """Consume a key and return its value, of any type."""
        if not self.has(name):
            near = get_close_matches(name, self._values, n=1)
            meant = f"; is it meant by {self.key(near[0])}?" if near else ""
            expected = f"{_UNIT_QUESTION.sub('', expected)} (the key is missing{meant})"
            raise HeadFileError(self.key(name), UnquotedText("nothing"), expected)
        return self._values.pop(name)

    def _take_one(
        self, name: str, expected: str, kind: type[T], fits: Callable[[T], object] = lambda _: True
    ) -> T:
        value = self.take(name, expected)
        # by its very type, as booleans are integers too
        self.expect(type(value) is kind and fits(value), name, value, expected)
        return value  # type: ignore[no-any-return]

    def integer(self, name: str, rule: Rule) -> int:
        """Consume an integer that a rule accepts."""
        return self._take_one(name, rule[1], int, rule[0])

    def text(self, name: str, expected: str) -> str:
        """Consume a string that is not blank."""
        return self._take_one(name, expected, str, str.strip)

    def choice(self, name: str, choices: Sequence[str]) -> str:
        """Consume a string that is one of the choices."""
        return self._take_one(name, f"one of {', '.join(choices)}", str, choices.__contains__)

    def boolean(self, name: str) -> bool:
        """Consume a boolean; false if it is left out."""
        return self.has(name) and self._take_one(name, "true or false", bool)

    def number(self, name: str, rule: Rule) -> float:
        """Consume a number that a rule accepts."""
        return _number(self.take(name, rule[1]), self.key(name), rule)

    def numbers(self, name: str, shape: tuple[int, ...], rule: Rule) -> FloatArray:
        """Consume an array of a given shape whose numbers a rule accepts."""
        value = self.take(name, _list_of(shape, rule))
        return np.array(_number_lists(value, self.key(name), shape, rule))

    def table(self, name: str) -> "Table":
        """Consume a nested table."""
        return Table(self.take(name, "a table"), self.key(name))

    def tables(self, name: str, count: int | None = None) -> list["Table"]:
        """Consume an array of `count` tables; any number for None."""
        expected = f"{'' if count is None else f'{count} '}tables [[{name}]]"
        values = self.take(name, expected)
        fits = _is_list(values) and count in (None, len(values))
        self.expect(fits, name, values, expected)
        return [Table(v, f"{self.key(name)}[{i}]") for i, v in enumerate(values)]

    def names(self) -> list[str]:
        """Keys that have not been consumed yet."""
        return list(self._values)

    def require_equal(self, name: str, expected: object, reason: str = "") -> None:
        """Consume a value and refuse it unless it equals the expected one; `reason` explains it."""
        said = f"{expected!r} ({reason})" if reason else repr(expected)
        value = self.take(name, said)
        self.expect(value == expected and not isinstance(value, bool), name, value, said)

    def close(self, known: Sequence[str] = ()) -> None:
        """Refuse the keys that remain, but for those that will be consumed later."""
        for name, value in self._values.items():
            if name not in known:
                near = get_close_matches(name, {*self._asked, *known}, n=1)
                meant = f" (is {self.key(near[0])} meant?)" if near else ""
                raise HeadFileError(self.key(name), value, f"no such key{meant}")


def _is_list(value: object) -> bool:
    return isinstance(value, Sequence) and not isinstance(value, str)


def _list_of(shape: tuple[int, ...], rule: Rule) -> str:
    """Description of an expected array, for messages."""
    counts = " lists of ".join(map(str, shape))
    return f"a list of {counts} numbers, each {_UNIT_QUESTION.sub('', rule[1])}"


def _number_lists(value: Any, key: str, shape: tuple[int, ...], rule: Rule) -> Any:
    """Nested lists of a given shape, of numbers that a rule accepts."""
    if not shape:
        return _number(value, key, rule)
    if not _is_list(value) or len(value) != shape[0]:
        raise HeadFileError(key, value, _list_of(shape, rule))
    return [_number_lists(one, f"{key}[{i}]", shape[1:], rule) for i, one in enumerate(value)]


def _number(value: object, key: str, rule: Rule) -> float:
    accepted, expected = rule
    number = np.nan
    if isinstance(value, int | float) and not isinstance(value, bool):
        with suppress(OverflowError):  # an integer beyond the floating-point range
            number = float(value)
    if not np.isnan(number) and accepted(number):
        return number
    asked = _UNIT_QUESTION.search(expected)
    if asked and not accepted(number * _UNIT_FACTORS[asked[1]]):
        expected = _UNIT_QUESTION.sub("", expected)
    raise HeadFileError(key, value, expected)


_MAX_LIST_CHARACTERS: Final = 80
"""Most characters of a list on one line (chosen: compact text against long lines)."""
_NUMBERS: Final = re.compile(r"\[\n((?:[ ]+[-+.\w]+,\n)+)[ ]*\]")
"""A list of numbers, one per line; strings contain no raw line breaks, so none matches."""


def toml_text(document: Mapping[str, Any]) -> str:
    """Write plain values as TOML."""
    return _NUMBERS.sub(_on_one_line, tomli_w.dumps(document))


def _on_one_line(found: re.Match[str]) -> str:
    line = f"[{', '.join(found[1].replace(',', ' ').split())}]"
    return line if len(line) <= _MAX_LIST_CHARACTERS else found[0]
