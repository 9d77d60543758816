"""`vergence info`: print versions, presets and optional parts, or describe one head."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from vergence.commands.head_info import print_head_description
from vergence.commands.options import check_figure
from vergence.commands.tables import print_table
from vergence.errors import ConfigurationError, how_to_install


@dataclass(frozen=True, kw_only=True)
class Info:
    """Show versions, presets and installed optional parts; or describe one head."""

    head: Annotated[str | None, tyro.conf.arg(help_behavior_hint="", metavar="HEAD")] = None
    """Head to describe, a preset's name or the path of a TOML file."""
    json: bool = False
    """Print the head's numbers as JSON."""
    figure: Annotated[Path | None, tyro.conf.arg(help_behavior_hint="", metavar="PATH")] = None
    """PNG file to draw the head to."""

    def run(self) -> int:
        """Run the command."""
        if self.head is not None:
            if self.figure is not None:
                check_figure(self.figure)
            print_head_description(self.head, as_json=self.json, figure=self.figure)
            return 0
        for option, given in (("json", self.json), ("figure", self.figure is not None)):
            if given:
                raise ConfigurationError(f"{option}: expected a head beside it (--head), got none")
        import gymnasium

        from vergence.envs.plant import PLANTS
        from vergence.envs.targets import TARGETS
        from vergence.eval.article.config import EXPERIMENTS
        from vergence.eval.comparison.contestants import controllers_in_table_order
        from vergence.eval.trials.scenarios import SCENARIOS
        from vergence.models.head_file import load_head, presets
        from vergence.reporting.runs import package_versions

        print_table(
            ["package", "version"],
            [list(pair) for pair in package_versions().items()],
            title="versions",
        )
        rows = []
        for name in presets():
            head = load_head(name)
            timing = head.timing
            rows.append(
                [
                    name,
                    _sizes(head.cameras.size.tolist()),
                    f"{timing.control_rate_hz:g} Hz, images {1000 * timing.latency_s:.1f} ms old, "
                    f"lag {1000 * timing.lag_s:g} ms",
                    head.digest[:12],
                ]
            )
        columns = ["head", "cameras", "loop", "digest"]
        print_table(columns, rows, title="presets", wrapped=(0, 2))
        known = (name for name in gymnasium.registry if name.startswith("vergence/"))
        rows = [
            ["plants", ", ".join(PLANTS)],
            ["controllers", ", ".join(controllers_in_table_order())],
            ["targets", ", ".join(TARGETS)],
            ["environments", ", ".join(sorted(known))],
            ["scenarios", ", ".join(SCENARIOS)],
            ["experiments", ", ".join(EXPERIMENTS)],
        ]
        print_table(["kind", "names"], rows, title="registries", wrapped=(0, 1))
        parts = ("onnx", "onnxruntime", "optuna", "pyarrow", "pygame", "ray")
        found = package_versions((*parts, "stable-baselines3", "torch"))
        rows = [
            [f"{package} ({use})", found.get(package) or _missing(extra)]
            for package, extra, use in (
                ("onnx", "learned", "export onnx"),
                ("onnxruntime", "learned", "a network of your own"),
                ("pyarrow", "parquet", "--parquet"),
                ("pygame", "render", "render_mode='human'"),
                ("ray", "cluster", "--cluster"),
                ("optuna", "tune", "tune"),
                ("stable-baselines3", "train", "learning"),
                ("torch", "train", "learning"),
            )
        ]
        print_table(["part", "state"], rows, title="optional parts", wrapped=(0, 1))
        return 0


def _sizes(sizes: list[list[int]]) -> str:
    """Image size of both eyes, or of each eye if they differ."""
    texts = [f"{width} x {height}" for width, height in sizes]
    return texts[0] if texts[0] == texts[1] else ", ".join(texts)


def _missing(extra: str) -> str:
    return f"not installed: {how_to_install(extra)}"
