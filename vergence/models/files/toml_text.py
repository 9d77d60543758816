"""Write plain values as readable TOML text, short lists of numbers on one line."""

import re
from collections.abc import Mapping
from typing import Any, Final

import tomli_w

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
