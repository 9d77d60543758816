"""Every number that the docs state as found is the number that a full run found."""

import math
import re
from pathlib import Path

from tests.eval.article.checks import full_run
from vergence.eval.article.registry import EXPERIMENTS

DOCS = Path(__file__).resolve().parents[3] / "docs"
NUMBERS = full_run()
_NUMBER = re.compile(r"(?<![\w.,])-?\d[\d,]*(?:\.\d+)?")


def bullets(text: str) -> list[str]:
    """The bullets of the section that says what was found."""
    section = text.partition("\n## What it found\n")[2].partition("\n## ")[0]
    return re.findall(r"^- .*?(?=^- |^#|\Z)", section, flags=re.MULTILINE | re.DOTALL)


def mistakes(bullet: str) -> list[str]:
    """Mistakes in a bullet, whose comment names the source of each number, in order."""
    named = re.search(r"<!-- ([a-z-]+): ([\w, \n]+) -->", bullet)
    if named is None:
        return [f"no sources: {bullet}"]
    stated = _NUMBER.findall(bullet[: named.start()])
    names = re.findall(r"\w+", named[2])
    if len(stated) != len(names):
        return [f"{len(stated)} numbers, {len(names)} sources: {bullet}"]
    found = NUMBERS[named[1]]
    return [
        f"{number} is not {name} = {found.get(name)}"
        for number, name in zip(stated, names, strict=True)
        if not agrees(number, found.get(name, math.nan))
    ]


def agrees(number: str, value: float) -> bool:
    """True if a number is a value rounded to the number's digits."""
    unit = 10.0 ** -len(number.partition(".")[2])
    return abs(float(number.replace(",", "")) - value) <= 0.500001 * unit


BULLETS = bullets((DOCS / "reproduce.md").read_text(encoding="utf-8"))


def test_each_number_of_the_docs_is_what_a_run_found():
    assert [mistake for bullet in BULLETS for mistake in mistakes(bullet)] == []


def test_the_docs_have_something_of_every_experiment():
    told = {re.search(r"<!-- ([a-z-]+):", bullet)[1] for bullet in BULLETS}
    assert told == set(NUMBERS) == set(EXPERIMENTS)
