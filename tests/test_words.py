"""Names that docstrings and comments mention in backticks are those of the code."""

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]

# A name in backticks, such as `HeadModel` or `settle_1px_s`; not a symbol such as `C_l`.
NAME = re.compile(r"`((?:\w+\.)*(?:[a-z]\w*_\w*[a-z0-9]{2}|[A-Z][a-z]+[A-Za-z0-9]+))(?:\(\))?`")

# Names of other packages, and columns whose names code composes.
OTHERS = {"NextStep", "SameStep", "Disabled", "Monitor", "TensorProto", "DataType",
          "error_p05_px", "error_p95_px", "error_x_mm", "settle_2_5px_s"}  # fmt: skip


def test_names_in_backticks_exist():
    paths = [*(ROOT / "vergence").rglob("*.py"), *(ROOT / "benchmarks").rglob("*.py")]
    sources = {path: path.read_text(encoding="utf-8") for path in paths}
    known = OTHERS.union(*(re.findall(r"\w+", NAME.sub("", text)) for text in sources.values()))
    known = known.union(*(path.relative_to(ROOT).with_suffix("").parts for path in paths))
    stale = [
        f"{path.relative_to(ROOT)}: {name}"
        for path, source in sources.items()
        for name in NAME.findall(source)
        if not known.issuperset(name.split("."))
    ]
    assert stale == []
