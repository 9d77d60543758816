"""What every experiment's table, summary and figures have to be, for the tests."""

from vergence.eval.article.reported import reported_results


def covers(rows, experiment):
    """Whether a summary has a row for everything the article reports of an experiment."""
    ours = {(row.experiment, row.quantity, row.method, row.axis) for row in rows}
    theirs = {
        (row.experiment, row.quantity, row.method, row.axis)
        for row in reported_results()
        if row.experiment == experiment
    }
    return bool(theirs) and theirs <= ours


def empty_panels(figures):
    """Panels of figures, by name and number, in which no data are drawn."""
    return [
        (name, number)
        for name, figure in figures.items()
        for number, panel in enumerate(figure.axes)
        if not any(len(line.get_xdata()) > 1 for line in panel.lines) and not panel.containers
    ]
