"""Texts of the report only fill in numbers; every number in the docs is what a full run found."""

import dataclasses
import math
import re
from pathlib import Path

import pytest
from jinja2 import meta, nodes

from tests.eval.article.checks import full_run
from vergence.eval.article.config import EXPERIMENTS
from vergence.eval.article.experiment import load_experiment, resolve_config
from vergence.reporting.text import jinja_environment, render_text

_CHOICES = (nodes.If, nodes.CondExpr, nodes.Test, nodes.Compare, nodes.For, nodes.And, nodes.Or)
_COUNTED = (
    "images", "points", "places", "samples", "trials", "heads", "fixes", "frames", "draws",
    "records", "fixations", "gains", "turns", "rows",
)  # fmt: skip
_TABLE_POINTS = 21
"""Points of Tables 3 and 5."""
_FEW = 12
"""Up to here a number may stand in a text for something else."""


def rendered(name, quick):
    experiment = load_experiment(name)
    names = meta.find_undeclared_variables(jinja_environment().parse(experiment.text))
    config = resolve_config(experiment, {}, quick)
    return render_text(experiment.text, config=config, **dict.fromkeys(names - {"config"}, 7.7))


def words(text):
    return "\n".join([text.what, text.found, text.headline, *text.captions.values()])


def test_a_template_chooses_no_words():
    for name in EXPERIMENTS:
        tree = jinja_environment().parse(load_experiment(name).text)
        blocks = {block.name for block in tree.find_all(nodes.Block)}
        assert blocks >= {"what", "found"}, name
        assert all(b.startswith("caption_") for b in blocks - {"what", "found", "headline"}), name
        assert list(tree.find_all(_CHOICES)) == [], name
        words = [each.value for each in tree.find_all(nodes.Const)]
        assert [each for each in words if isinstance(each, str)] == [], name


def test_a_template_counts_nothing_by_itself():
    counted = rf"(?<![\d.,])\d[\d,]*\s+(?:{'|'.join(_COUNTED)})\b(?!\s+a\s+second)"
    for name in EXPERIMENTS:
        bare = re.sub(r"{{.*?}}|{%.*?%}", "N", load_experiment(name).text, flags=re.DOTALL)
        assert re.findall(counted, bare) == [], name


def test_the_text_of_a_quick_run_has_no_count_of_the_full_one():
    for name in EXPERIMENTS:
        experiment = load_experiment(name)
        full, own = (dataclasses.asdict(resolve_config(experiment, {}, q)) for q in (False, True))
        counts = {_TABLE_POINTS, *(value for value in full.values() if isinstance(value, int))}
        counts -= {*range(_FEW), *(value for value in own.values() if isinstance(value, int))}
        numbers = re.findall(r"(?<![\w.,-])\d[\d,]*(?:\.\d+)?", words(rendered(name, quick=True)))
        assert not counts & {float(number.strip(",").replace(",", "")) for number in numbers}, name


@pytest.mark.slow
def test_every_count_of_a_configuration_that_a_text_states_is_that_runs():
    for name in EXPERIMENTS:
        quick, full = words(rendered(name, quick=True)), words(rendered(name, quick=False))
        experiment = load_experiment(name)
        stated = [f for f in experiment.quick if re.search(rf"config\.{f}\b", experiment.text)]
        assert (quick != full) == bool(stated), name


def test_three_sentences_stand_at_the_top_of_the_report():
    headlines = [rendered(name, quick=False).headline for name in EXPERIMENTS]
    assert len([text for text in headlines if text]) == 3
    assert all(text.endswith(".") for text in headlines if text)


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
