"""Values that no experiment can run with are refused before anything runs."""

import dataclasses

from tests.eval.refusals import not_refused
from vergence.eval.article.config import EXPERIMENTS
from vergence.eval.article.experiment import load_experiment, resolve_config
from vergence.models import load_head, save_head

CASES = [
    ("gain-sweep", {"gain_step": 0}), ("gain-sweep", {"plane_step": 0.0}),
    ("gain-sweep", {"lag_step_s": 0.0}), ("gain-sweep", {"gain_step": 1e-9}),
    ("gain-sweep", {"least_gain": 7.0}), ("gain-sweep", {"onset_gains": [4.2, 4.0]}),
    ("gain-sweep", {"onset_gains": [4.2]}), ("gain-sweep", {"point_mm": [0.0, 1000.0]}),
    ("time-response", {"threshold_step_px": 0.0}), ("time-response", {"least_threshold_px": 6.0}),
    ("time-response", {"delays_frames": [-1]}), ("simulated-moving", {"period_s": 0.0}),
    ("simulated-static", {"point_step": 0}), ("uncertainty", {"gains": [0.0]}),
    ("physical-static", {"samples": 0}), ("physical-moving", {"speed_m_s": 0.0}),
    ("fixed-pair", {"pair_focal_px": 0.0}),
]  # fmt: skip


def resolve(case) -> None:
    name, overrides = case
    resolve_config(load_experiment(name), overrides, quick=False)


def test_a_value_that_cannot_be_is_refused() -> None:
    said = [
        rf"^{name}.*{field}.*expected|^{name}: .*{field}"
        for name, overrides in CASES
        for field in overrides
    ]
    assert not_refused(resolve, zip(CASES, said, strict=True)) == []


def test_experiments_are_of_the_article_s_own_heads_alone() -> None:
    names = ("gain-sweep", "time-response", "physical-static")
    cases = [((name, {"head": "turrets"}), "expected simulated or physical") for name in names]
    assert not_refused(resolve, cases) == []


def test_the_article_s_heads_may_come_from_a_file(tmp_path) -> None:
    save_head(load_head("physical"), tmp_path / "mine.toml")
    config = resolve_config(
        load_experiment("time-response"), {"head": str(tmp_path / "mine.toml")}, quick=False
    )
    assert config.head == str(tmp_path / "mine.toml")


def test_every_default_passes_its_own_rules() -> None:
    for experiment in map(load_experiment, EXPERIMENTS):
        for quick, changes in ((False, {}), (True, experiment.quick)):
            default = dataclasses.replace(experiment.config(), **changes)
            values = {
                field.name: getattr(default, field.name)
                for field in dataclasses.fields(default)
                if not dataclasses.is_dataclass(getattr(default, field.name))
            }
            assert resolve_config(experiment, values, quick) == default
