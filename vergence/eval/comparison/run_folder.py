"""Common part of all comparisons' run folders: figures, config.toml, and a section and report."""

from collections.abc import Iterable, Mapping
from pathlib import Path

from matplotlib.figure import Figure

from vergence.eval.comparison.config import EvaluateConfig
from vergence.eval.comparison.run_config import (
    ControllerRun,
    config_with_notes,
    write_config_and_heads,
)
from vergence.reporting.report import (
    SECTION_FILE,
    ReportSection,
    ReportTable,
    write_report,
    write_section,
)
from vergence.reporting.style import save_figure
from vergence.reporting.text import SectionText


def write_run_report(
    folder: Path,
    *,
    name: str,
    title: str,
    text: SectionText,
    tables: list[ReportTable],
    figures: Mapping[str, Figure],
    captions: Mapping[str, str],
    data_file: str,
    data_row_count: int,
    config: EvaluateConfig,
    notes: list[str],
    failures: list[str],
    outcomes: Iterable[ControllerRun],
) -> None:
    """Write figures, configuration, section and report beside the tables of a run folder.

    Args:
        folder: the run folder.
        name: name of the section.
        title: title of the section and of the report.
        text: text of the section.
        tables: tables of the section.
        figures: figures by name.
        captions: captions by the figures' names.
        data_file: the section's data file in the folder.
        data_row_count: number of rows of the data file.
        config: the configuration.
        notes: notes on controllers and plants that were left out.
        failures: errors of user-defined controllers.
        outcomes: results of the controllers that ran.
    """
    (folder / "figures").mkdir()
    for figure_name, figure in figures.items():
        save_figure(figure, folder / "figures" / figure_name)
    write_config_and_heads(folder, config, notes, failures, outcomes)
    section = ReportSection(
        name=name,
        title=title,
        article="",
        what=text.what,
        conclusion=text.found,
        summary=[],
        figures=[folder / "figures" / f"{figure_name}.svg" for figure_name in figures],
        rows=data_row_count,
        config=config_with_notes(config, notes, failures),
        seed=config.seed,
        data=data_file,
        tables=tables,
        captions=dict(captions),
    )
    write_section(folder / SECTION_FILE, section)
    write_report(folder / "report.html", [section], title=title)
