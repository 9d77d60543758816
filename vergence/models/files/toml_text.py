"""Plain values as TOML text that people read: short lists of numbers on one line."""

import re
from collections.abc import Mapping
from typing import Any, Final

import tomli_w

_LONGEST: Final = 80
"""Characters of a list on one line."""
_NUMBERS: Final = re.compile(r"\[\n((?:[ ]+[-+.\w]+,\n)+)[ ]*\]")
"""A list of numbers with one on each line; no text has a line break of its own."""


def toml_text(document: Mapping[str, Any]) -> str:
    """Write plain values as TOML.

    Args:
        document: tables, lists, numbers, texts by key.
    """
    return _NUMBERS.sub(_on_one_line, tomli_w.dumps(document))


def _on_one_line(found: re.Match[str]) -> str:
    line = f"[{', '.join(found[1].replace(',', ' ').split())}]"
    return line if len(line) <= _LONGEST else found[0]
