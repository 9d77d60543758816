"""All that a plant holds open: the servos' line, the cameras, an emulated head's world."""

from contextlib import ExitStack

from vergence.hardware.cameras import EyeThread
from vergence.hardware.drive import Drive
from vergence.hardware.emulator.client import EmulatedWorld


class OpenedHead:
    """Servos, eyes and world of an open plant; it outlives the plant by its `close` alone."""

    def __init__(self) -> None:
        self.drive: Drive | None = None
        self.eyes: list[EyeThread] = []
        self.world: EmulatedWorld | None = None
        self.settings = ExitStack()

    def close(self) -> None:
        """Stop the servos at once, and release all; a second call does nothing."""
        drive, self.drive = self.drive, None
        eyes, self.eyes = self.eyes, []
        world, self.world = self.world, None
        try:
            if drive is not None:
                drive.close()
        finally:
            for eye in eyes:
                eye.close()
            if world is not None:
                world.close()
            self.settings.close()
