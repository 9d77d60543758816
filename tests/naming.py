"""Many cheap cases in one test: the one that fails is named."""

from collections.abc import Iterator
from contextlib import contextmanager

import pytest


@contextmanager
def named(*case: object) -> Iterator[None]:
    """Add the case to the report of what fails within."""
    try:
        yield
    except (Exception, pytest.fail.Exception) as error:
        error.add_note(f"in the case {case!r:.500}")
        raise
