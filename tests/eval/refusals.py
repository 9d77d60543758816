"""Lists of what cannot be: each value, and what is said of it."""

import re
from collections.abc import Callable, Iterable
from typing import Any

from vergence.errors import VergenceError


def not_refused(call: Callable[[Any], object], cases: Iterable[tuple[Any, str]]) -> list[Any]:
    """Each value that a call does not refuse in one line, what was to be said of it and what was.

    The cases are values with a regular expression that is to be found in what is said.
    """
    wrong = []
    for value, pattern in cases:
        try:
            call(value)
            said = "nothing"
        except VergenceError as error:
            said = str(error)
        if "\n" in said or not re.search(pattern, said):
            wrong.append((value, pattern, said))
    return wrong
