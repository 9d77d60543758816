"""The whole way: an emulated head on the wire, two streams, and a law that turns it."""

import json
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.hardware.emulated import emulated

README = Path(__file__).resolve().parents[2] / "README.md"
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(sys.platform != "linux", reason="pseudo-terminals as serial lines"),
]


@pytest.fixture(scope="module")
def desk(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """The configuration of an emulated head."""
    with emulated(tmp_path_factory.mktemp("desk")) as (path, _process):
        yield path


def gaze(desk: Path, out: Path, *options: str) -> subprocess.CompletedProcess[str]:
    """`vergence gaze` on the emulated head."""
    words = ["gaze", "--plant", "hardware", "--config", str(desk), "--out", str(out), *options]
    return subprocess.run(
        [sys.executable, "-m", "vergence", *words], capture_output=True, text=True, timeout=300
    )


def test_the_command_turns_the_head_to_the_target(desk: Path, tmp_path: Path) -> None:
    done = gaze(
        desk, tmp_path / "run", "--controller", "state-feedback", "--target", "50", "-80", "900"
    )
    assert done.returncode == 0, done.stderr
    result = json.loads((tmp_path / "run" / "result.json").read_text())
    assert result["truth_mm"] == pytest.approx([50.0, -80.0, 900.0])
    assert (tmp_path / "run" / "hardware.toml").read_text() == desk.read_text()
    for fix in (result["gaze"], result["itpc"]):
        assert (np.abs(fix["error_mm"]) < 3.5 * np.array(fix["sigma_mm"])).all()


def test_the_ten_lines_of_the_readme_run_on_it(desk: Path) -> None:
    code = re.findall(r"```python\n(.*?)```", README.read_text(encoding="utf-8"), re.DOTALL)[0]
    imports, head, make, *rest = (line for line in code.splitlines() if line)
    assert head.startswith("head = ")
    assert make.startswith("env = ")
    lines = [
        imports,
        f"env = gym.make('vergence/GazeHardware-v0', config={str(desk)!r})",
        "head = env.unwrapped.task.head",
        *rest,
    ]
    names: dict[str, Any] = {}
    try:
        exec("\n".join(lines), names)
        assert names["truncated"]
        assert np.abs(names["env"].unwrapped.truth().pixel_error).max() < 2.0
    finally:
        names["env"].close()
