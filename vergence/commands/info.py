"""`vergence info`: what is there."""

from dataclasses import dataclass

from rich.console import Console
from rich.markup import escape
from rich.table import Table


@dataclass(frozen=True, kw_only=True)
class Info:
    """Show versions, presets, and which optional parts are there."""

    def run(self) -> int:
        """Run the command."""
        import gymnasium

        from vergence.envs.opengl import opengl_failure
        from vergence.envs.plant import PLANTS
        from vergence.envs.targets.registry import TARGETS
        from vergence.eval.article.experiment import EXPERIMENTS
        from vergence.eval.comparison.contestants import ladder
        from vergence.eval.reporting.runs import versions
        from vergence.eval.trials.scenarios import SCENARIOS
        from vergence.models.files.head_file import load_head, presets

        console = Console(highlight=False)
        table = Table("package", "version", title="versions", title_justify="left")
        for package, version in versions().items():
            table.add_row(package, version)
        console.print(table)
        table = Table("head", "cameras", "loop", "digest", title="presets", title_justify="left")
        for name in presets():
            head = load_head(name)
            timing = head.timing
            table.add_row(
                name,
                f"{head.cameras.width} x {head.cameras.height}",
                f"{timing.control_rate_hz:g} Hz, images {1000 * timing.latency_s:.1f} ms old, "
                f"lag {1000 * timing.lag_s:g} ms",
                head.digest[:12],
            )
        console.print(table)
        table = Table("kind", "names", title="registries", title_justify="left")
        table.add_row("plants", ", ".join(PLANTS))
        table.add_row("controllers", ", ".join(ladder()))
        table.add_row("targets", ", ".join(TARGETS))
        known = (name for name in gymnasium.registry if name.startswith("vergence/"))
        table.add_row("environments", ", ".join(sorted(known)))
        table.add_row("scenarios", ", ".join(SCENARIOS))
        table.add_row("experiments", ", ".join(EXPERIMENTS))
        console.print(table)
        table = Table("part", "state", title="optional parts", title_justify="left")
        found = versions(
            ("onnx", "onnxruntime", "optuna", "pygame", "ray", "stable-baselines3", "torch")
        )
        for package, extra, use in (
            ("onnx", "learned", "learned controllers"),
            ("onnxruntime", "learned", "learned controllers"),
            ("pygame", "render", "render_mode='human'"),
            ("ray", "cluster", "--cluster"),
            ("optuna", "tune", "tune"),
            ("stable-baselines3", "train", "learning"),
            ("torch", "train", "learning"),
        ):
            state = found.get(package) or f"not installed: pip install 'vergence[{extra}]'"
            table.add_row(f"{package} ({use})", escape(state))
        failure = opengl_failure()
        state = "works"
        if failure is not None:
            state = f"not available ({failure}): a schematic is drawn instead"
        table.add_row("OpenGL (view of the head in render())", escape(state))
        console.print(table)
        return 0
