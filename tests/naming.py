"""Many cheap cases in one test: the one that fails is named."""

import pickle
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest

from vergence.errors import ConfigurationError


@contextmanager
def named(*case: object) -> Iterator[None]:
    """Add the case to the report of what fails within."""
    try:
        yield
    except (Exception, pytest.fail.Exception) as error:
        error.add_note(f"in the case {case!r:.500}")
        raise


def refused(said: str, call: Any, *given: Any, error: Any = ConfigurationError, **more: Any) -> Any:
    """The error that a call ends in: of one line, which a pattern fits, also when it is pickled."""
    with named(said, given, more), pytest.raises(error, match=said) as caught:
        call(*given, **more)
    assert "\n" not in str(caught.value)
    assert str(pickle.loads(pickle.dumps(caught.value))) == str(caught.value)
    return caught.value
