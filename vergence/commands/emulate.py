"""`vergence emulate`: emulate the servos and cameras of a head, without a robot."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import tyro

from vergence.commands.console import print_to_stderr
from vergence.commands.options import Flat
from vergence.errors import ConfigurationError
from vergence.hardware.emulator.config import EmulatorConfig


@dataclass(frozen=True, kw_only=True)
class Emulate:
    """Emulate a head until Ctrl-C: servos on a pseudo-terminal, two camera streams."""

    config: Flat[EmulatorConfig] = field(default_factory=EmulatorConfig)
    errors: Annotated[float, tyro.conf.arg(metavar="SCALE")] = 0.0
    """Scale of the head's deviations from its file, which controllers use: 1 for the spreads of
    the article's head before calibration, 0 for none."""
    out: Annotated[Path | None, tyro.conf.arg(help_behavior_hint="", metavar="PATH")] = None
    """File to write the emulated head's configuration to; printed by default."""

    def run(self) -> int:
        """Run the command."""
        if self.out is not None and (self.out.is_dir() or not self.out.parent.is_dir()):
            raise ConfigurationError(
                f"out: expected a file in a folder that is there, got {self.out}"
            )
        head = Path(self.config.head)
        if self.out and self.out.exists() and head.exists() and self.out.samefile(head):
            raise ConfigurationError(f"out: expected another file than the head, got {self.out}")
        if not 0.0 <= self.errors <= 10.0:
            raise ConfigurationError(f"errors: expected a scale, 0 to 10, got {self.errors}")
        from vergence.eval.trials.twin_errors import TWIN_SPREADS
        from vergence.files import write_atomic
        from vergence.hardware.emulator.server import emulate

        def ready(text: str) -> None:
            if self.out is None:
                print(text, end="", flush=True)
                print_to_stderr(
                    "emulating this head until Ctrl-C: save the lines above as desk.toml"
                )
                return
            write_atomic(self.out, text)
            print_to_stderr(
                f"emulating until Ctrl-C: vergence gaze --plant hardware --config {self.out}"
            )

        errors = TWIN_SPREADS.scaled(self.errors) if self.errors else None
        emulate(self.config, ready, model_errors=errors)
        return 0
