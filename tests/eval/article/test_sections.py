"""The texts of the report are written by people: their templates fill in numbers and no more."""

import dataclasses
import re

import pytest
from jinja2 import meta, nodes

from vergence.eval.article.experiment import load_experiment, resolve_config
from vergence.eval.article.registry import EXPERIMENTS
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
