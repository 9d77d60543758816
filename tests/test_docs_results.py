"""The numbers of README and docs are those of the tables that they come from."""

from benchmarks.kept import KEPT, ROOT, file_of, numbers_of, tables
from benchmarks.marks import disagreements, stated_numbers
from tests.naming import named


def test_numbers_of_evaluations_are_their_tables() -> None:
    for name, number in (
        ("README.md", 19), ("docs/evaluate.md", 133), ("docs/controllers.md", 65),
        ("docs/environment.md", 20), ("docs/learning.md", 150), ("docs/stable-baselines3.md", 27),
        ("docs/vision.md", 98),
    ):  # fmt: skip
        with named(name):
            document = (ROOT / name).read_text(encoding="utf-8")
            assert len([one for one in stated_numbers(document) if one.text]) >= number
            assert disagreements(document, tables()) == []


def test_every_controller_settles_in_every_trial_of_the_readmes_table() -> None:
    results = numbers_of(file_of("evaluate"), KEPT["evaluate"].columns)
    for scenario in ("workspace", "robust"):
        keys = [key for key in results if key.startswith(f"{scenario}/kinematic/")]
        shares = [results[key] for key in keys if key.endswith("/settled_fraction")]
        assert shares == [1.0] * 12
