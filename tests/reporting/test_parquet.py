"""Parquet holds what CSV holds, and CSV what the run computed, to the last digit."""

from csv import DictReader

import numpy as np
import pandas as pd

from vergence.reporting.runs import write_parquet


def test_floats_come_back_from_both_formats_to_the_last_digit(tmp_path):
    rng = np.random.default_rng(0)
    table = pd.DataFrame(
        {
            "value": np.append(
                rng.normal(size=2000) * 10.0 ** rng.integers(-300, 300, 2000), [np.nan, np.inf]
            ),
            "seen": np.arange(2002) % 2 == 0,
            "count": np.arange(2002),
            "name": "ibvs",
        }
    )
    csv = tmp_path / "table.csv"
    table.to_csv(csv, index=False)
    with csv.open(encoding="utf-8", newline="") as file:
        read = [float(row["value"] or "nan") for row in DictReader(file)]
    np.testing.assert_array_equal(read, table["value"])
    path = write_parquet(csv)
    assert path == tmp_path / "table.parquet"
    pd.testing.assert_frame_equal(pd.read_parquet(path), table, check_exact=True)
