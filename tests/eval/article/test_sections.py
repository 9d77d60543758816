"""The texts of the report are written by people: their templates fill in numbers and no more."""

import jinja2
import pytest
from jinja2 import nodes

from vergence.eval.article.experiment import EXPERIMENTS, load_experiment

_CHOICES = (nodes.If, nodes.CondExpr, nodes.Test, nodes.Compare, nodes.For, nodes.And, nodes.Or)


@pytest.mark.parametrize("name", EXPERIMENTS)
def test_a_template_chooses_no_words(name):
    tree = jinja2.Environment().parse(load_experiment(name).text)
    assert {block.name for block in tree.find_all(nodes.Block)} == {"what", "found"}
    assert list(tree.find_all(_CHOICES)) == []
    assert [constant.value for constant in tree.find_all(nodes.Const) if _word(constant)] == []


def _word(constant):
    return isinstance(constant.value, str)
