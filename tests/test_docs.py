"""The examples of README and guide run as they stand there, on smaller numbers."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
SMALLER = {
    "10_000": "64",
    "2_000_000": "1_000",
    "episodes=200": "episodes=5",
    "range(240)": "range(30)",
}
"""Numbers of the examples, and what stands for them here: time, not meaning, is in them."""


def examples(name: str) -> list[str]:
    """The Python blocks of a document."""
    text = (ROOT / name).read_text(encoding="utf-8")
    blocks = re.findall(r"```python\n(.*?)```", text, flags=re.DOTALL)
    for number, less in SMALLER.items():
        blocks = [block.replace(number, less) for block in blocks]
    return blocks


@pytest.mark.parametrize("name", ["README.md", "docs/guide.md"])
@pytest.mark.filterwarnings("ignore:You are trying to run PPO on the GPU:UserWarning")
def test_the_examples_of_a_document_run_one_after_the_other(name, capsys) -> None:
    found = examples(name)
    assert found
    names: dict[str, object] = {}
    for block in found:
        exec(compile(block, name, "exec"), names)
    assert capsys.readouterr().out.strip()  # each document's examples show something


def test_a_controller_of_ones_own_takes_fifteen_lines() -> None:
    block = next(block for block in examples("docs/guide.md") if "class " in block)
    body = block[block.index("class ") : block.index("head = ")]
    lines = [line for line in body.splitlines() if line.strip()]
    assert len(lines) <= 15


def test_the_places_that_contributing_names_exist() -> None:
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    places = set(re.findall(r"`((?:vergence|tests|docs|benchmarks)/[^`*]*)`", text))
    questions = re.findall(r"^\| .*\? \| `[^`]+` \|$", text, flags=re.MULTILINE)
    assert len(questions) >= 20
    assert {place for place in places if not (ROOT / place).exists()} == set()
