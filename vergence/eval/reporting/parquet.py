"""Tables as Parquet, beside the CSV that every run writes."""

from pathlib import Path

from vergence.files import whole_file


def write_parquet(csv: Path) -> Path:
    """Write a table as Parquet beside its CSV; pyarrow must be installed.

    Args:
        csv: the table. Its floats come back to the last digit.

    Returns:
        The new file, of the same name with the ending `.parquet`.

    Raises:
        OSError: it cannot be written.
    """
    from pyarrow.csv import read_csv
    from pyarrow.parquet import write_table

    path = csv.with_suffix(".parquet")
    table = read_csv(csv)  # exact, which pandas' own reader is from version 3 on
    with whole_file(path) as partial:
        write_table(table, partial)
    return path
