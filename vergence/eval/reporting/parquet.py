"""Conversion of a run's CSV tables to Parquet."""

from pathlib import Path

from vergence.files import atomic_file


def write_parquet(csv: Path) -> Path:
    """Write a table as Parquet next to its CSV file; pyarrow must be installed.

    Args:
        csv: the table. Its floats are converted without loss.

    Returns:
        The new file, with the same name and the suffix `.parquet`.

    Raises:
        OSError: the file cannot be written.
    """
    from pyarrow.csv import read_csv
    from pyarrow.parquet import write_table

    path = csv.with_suffix(".parquet")
    table = read_csv(csv)  # exact floats; pandas' own reader is exact only from version 3 on
    with atomic_file(path) as partial:
        write_table(table, partial)
    return path
