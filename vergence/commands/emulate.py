"""`vergence emulate`: a head on the wire, without a robot."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from vergence.commands.console import note


@dataclass(frozen=True, kw_only=True)
class Emulate:
    """Emulate a head: servos on a pseudo-terminal, two camera streams; until Ctrl-C."""

    head: Annotated[str, tyro.conf.arg(metavar="HEAD")] = "turrets"
    """Head: a preset's name (see `vergence info`) or the path of a TOML file."""
    out: Annotated[Path | None, tyro.conf.arg(help_behavior_hint="", metavar="PATH")] = None
    """Where to write the configuration of this head; printed by default."""
    target_mm: Annotated[
        tuple[float, float, float], tyro.conf.arg(name="target", metavar="X Y Z")
    ] = (0.0, -100.0, 1000.0)
    """Where the target stands until somebody places it, in mm, in the base frame N: x right, y
    down, z forward."""
    latency_s: Annotated[
        float | None, tyro.conf.arg(name="latency", help_behavior_hint="", metavar="SECONDS")
    ] = None
    """From the middle of an exposure to its image being sent; the head's by default."""
    jitter_s: Annotated[float, tyro.conf.arg(name="jitter", metavar="SECONDS")] = 0.0
    """The most by which an image is sent later than that."""
    right_late_s: Annotated[float, tyro.conf.arg(name="right-late", metavar="SECONDS")] = 0.0
    """By how much the right camera exposes later than the left one."""
    speed_filter_s: Annotated[float, tyro.conf.arg(name="speed-filter", metavar="SECONDS")] = 0.0
    """Time constant of the filter through which the servos report their speeds."""
    port: int = 0
    """Port of the streams, on this machine alone; 0 for any that is free."""
    seed: int = 0
    """Seed of the noise of the images and of the jitter."""

    def run(self) -> int:
        """Run the command."""
        from vergence.files import write_whole
        from vergence.hardware.emulator.emulator import EmulatorConfig, emulate

        def ready(text: str) -> None:
            if self.out is None:
                print(text, end="", flush=True)
                return
            write_whole(self.out, text)
            note(
                f"{self.out} is the configuration of this head: vergence gaze --plant hardware "
                f"--config {self.out} --controller state-feedback"
            )

        emulate(
            EmulatorConfig(
                head=self.head,
                target_mm=self.target_mm,
                latency_s=self.latency_s,
                jitter_s=self.jitter_s,
                right_late_s=self.right_late_s,
                speed_filter_s=self.speed_filter_s,
                port=self.port,
                seed=self.seed,
            ),
            ready,
        )
        return 0
