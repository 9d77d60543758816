"""Sections as files: read as they were written, and refused where they are damaged."""

import json
import shutil

import pytest

from tests.eval.refusals import not_refused
from vergence.errors import ConfigurationError
from vergence.reporting.report import (
    SECTION_FILE,
    ReportSection,
    ReportTable,
    read_section,
    write_section,
)


def section_in(folder):
    """A section with a table, and a figure in the folder."""
    figure = folder / "figures" / "curve.svg"
    figure.parent.mkdir()
    figure.write_text('<?xml version="1.0"?>\n<svg width="9"><path d="M0 0"/></svg>\n')
    return ReportSection(
        name="work", title="Work", article="", what="Ran.", conclusion="Went well.", summary=[],
        figures=[figure], rows=2, config={"episodes": 2}, seed=3, data="trials.csv",
        tables=[ReportTable(title="Times", columns=["law", "s"], rows=[["ibvs", "0.3"]])],
        captions={"curve": "It falls."},
    )  # fmt: skip


@pytest.fixture
def run(tmp_path):
    folder = tmp_path / "first run"
    folder.mkdir()
    write_section(folder / SECTION_FILE, section_in(folder))
    return folder


def test_a_section_is_read_as_it_was_written(tmp_path):
    section = section_in(tmp_path)
    write_section(tmp_path / SECTION_FILE, section)
    assert read_section(tmp_path / SECTION_FILE) == section


def test_a_section_shows_no_file_but_its_own_figures(tmp_path, run):
    content = json.loads((run / SECTION_FILE).read_text())
    (tmp_path / "secret.svg").write_text("<svg></svg>")
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "evaluation.json").write_text("[]")

    def attempt(figure):
        section = json.dumps({**content, "figures": [figure]})
        (tmp_path / "run" / SECTION_FILE).write_text(section)
        read_section(tmp_path / "run" / SECTION_FILE)

    files = ("../secret.svg", "figures/none.svg", "evaluation.json")
    cases = [(file, "include: expected a figure of the run") for file in files]
    assert not_refused(attempt, cases) == []


NO_RUN = "include: expected the folder of a run"


def test_a_section_with_values_of_another_type_is_refused(tmp_path, run):
    values = [
        ("what", 3), ("rows", "many"), ("summary", [{"experiment": "x"}]),
        ("tables", [{"title": "x", "columns": ["a"], "rows": [[1]]}]), ("tables", {"title": "x"}),
        ("figures", 5),
    ]  # fmt: skip
    copy = shutil.copytree(run, tmp_path / "run")
    content = json.loads((copy / SECTION_FILE).read_text())

    def attempt(field):
        (copy / SECTION_FILE).write_text(json.dumps({**content, field[0]: field[1]}))
        read_section(copy / SECTION_FILE)

    assert not_refused(attempt, [(value, NO_RUN) for value in values]) == []


def test_a_section_that_is_no_json_is_refused(tmp_path):
    def attempt(text):
        (tmp_path / SECTION_FILE).write_text(text)
        read_section(tmp_path / SECTION_FILE)

    texts = ("", "{", "[" * 10_000, "[]")
    assert not_refused(attempt, [(text, NO_RUN) for text in texts]) == []


def test_a_section_whose_figure_is_cut_is_refused(tmp_path, run):
    copy = shutil.copytree(run, tmp_path / "run")
    figure = next((copy / "figures").glob("*.svg"))
    figure.write_bytes(figure.read_bytes()[:-20])
    with pytest.raises(ConfigurationError, match="include: expected a whole SVG file"):
        read_section(copy / SECTION_FILE)
