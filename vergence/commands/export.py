"""`vergence export`: write the head or a trained network in formats of other tools."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from vergence.commands.extras import require_modules
from vergence.commands.options import claimed_run_folder
from vergence.errors import ConfigurationError


@dataclass(frozen=True, kw_only=True)
class _ExportModel:
    head: Annotated[str, tyro.conf.arg(metavar="HEAD")] = "simulated"
    """Head: a preset's name or the path of a TOML file."""
    out: Annotated[Path | None, tyro.conf.arg(help_behavior_hint="", metavar="PATH")] = None
    """Folder to write to, new or empty; export-FORMAT-HEAD by default."""

    def _write(self, format: Literal["mjcf", "urdf"]) -> int:
        from vergence.models.head_file import load_head
        from vergence.models.mujoco.export import export_files
        from vergence.vision.targets import AprilTag

        head = load_head(self.head)

        def write(folder: Path) -> None:
            for name, content in export_files(head, format, {"tag": AprilTag()}).items():
                path = folder / name
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_bytes(content)

        with claimed_run_folder(self.out or Path(f"export-{format}-{head.name}")) as export:
            if not export.save(write):
                return 2
            for path in sorted(export.folder.rglob("*")):
                if path.is_file():
                    print(path)
        return 0


@dataclass(frozen=True, kw_only=True)
class ExportMjcf(_ExportModel):
    """Write the head as a MuJoCo model."""

    def run(self) -> int:
        """Run the command."""
        return self._write("mjcf")


@dataclass(frozen=True, kw_only=True)
class ExportUrdf(_ExportModel):
    """Write the head as a URDF."""

    def run(self) -> int:
        """Run the command."""
        return self._write("urdf")


@dataclass(frozen=True, kw_only=True)
class ExportBundle:
    """Write a training run's network as a bundle: one file that needs no torch and no pickle."""

    training_run: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="RUN")]
    """Run folder of `vergence train`."""
    out: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="OUT.vgp")]
    """Bundle to write."""
    checkpoint: Literal["best", "last"] = "best"
    """Checkpoint of the run to export."""
    force: bool = False
    """Replace an existing file."""

    def run(self) -> int:
        """Run the command."""
        require_modules("train", "torch", "stable_baselines3")
        if self.out.suffix != ".vgp":
            raise ConfigurationError(f"out: expected a name that ends in .vgp, got {self.out}")
        _check_free(self.out, self.force)
        from vergence.files import hold_lock
        from vergence.training.export import export_run

        with hold_lock(self.out):
            manifest = export_run(self.training_run, self.out, self.checkpoint, self.force)
        step = manifest.training["checkpoint"]["step"]
        difference = manifest.metrics["learner_difference"]
        print(
            f"{self.out}: {manifest.kind} after {step} steps, {self.out.stat().st_size} bytes, "
            f"agrees with torch to {difference:.1g}"
        )
        return 0


@dataclass(frozen=True, kw_only=True)
class ExportOnnx:
    """Write a bundle's network as an ONNX file, for other tools."""

    bundle: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="BUNDLE")]
    """A .vgp file, or the name of a shipped bundle, such as policy-simulated."""
    out: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="OUT.onnx")]
    """File to write."""
    force: bool = False
    """Replace an existing file."""

    def run(self) -> int:
        """Run the command."""
        if self.out.suffix != ".onnx":
            raise ConfigurationError(f"out: expected a name that ends in .onnx, got {self.out}")
        _check_free(self.out, self.force)
        from vergence.controllers.networks.bundle import find_bundle
        from vergence.controllers.networks.onnx import bundle_as_onnx
        from vergence.files import write_atomic

        bundle = find_bundle(self.bundle)
        write_atomic(self.out, bundle_as_onnx(bundle))
        network = bundle.network
        print(
            f"{self.out}: inputs (batch, {network.input_size}), actions (batch, "
            f"{network.output_size}), the manifest in its metadata"
        )
        return 0


def _check_free(out: Path, force: bool) -> None:
    if out.exists() and not force:
        raise ConfigurationError(
            f"out: expected no file of that name (--force replaces it), got {out}"
        )


@dataclass(frozen=True, kw_only=True)
class Export:
    """Write the head or a trained network in formats of other tools."""

    what: tyro.conf.OmitSubcommandPrefixes[
        tyro.conf.OmitArgPrefixes[
            Annotated[ExportMjcf, tyro.conf.subcommand("mjcf")]
            | Annotated[ExportUrdf, tyro.conf.subcommand("urdf")]
            | Annotated[ExportBundle, tyro.conf.subcommand("bundle")]
            | Annotated[ExportOnnx, tyro.conf.subcommand("onnx")]
        ]
    ]

    def run(self) -> int:
        """Run the command."""
        return self.what.run()
