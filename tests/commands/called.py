"""Commands called in this process."""

import pytest

from vergence.cli import main


def call(*words: object) -> int:
    with pytest.raises(SystemExit) as stopped:
        main([str(word) for word in words])
    return int(stopped.value.code or 0)


def refused(capsys: pytest.CaptureFixture[str], *words: object) -> str:
    """The one line in which a command ends that cannot begin."""
    assert call(*words) == 2
    out, err = capsys.readouterr()
    assert out == ""
    (line,) = err.splitlines()
    assert line.startswith("vergence: error: ")
    return line


def run(capsys: pytest.CaptureFixture[str], *words: object) -> tuple[int, str, str]:
    """The exit code of a command, what is printed and what is said on standard error."""
    return call(*words), *capsys.readouterr()
