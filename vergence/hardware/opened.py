"""All that a plant holds open: the servos' line, the cameras, an emulated head's world."""

from contextlib import ExitStack

from vergence.hardware.cameras import EyeThread
from vergence.hardware.emulator.client import EmulatedWorld
from vergence.hardware.servos import HeadServos


class OpenedHead:
    """Servos, eyes and world of an open plant; it outlives the plant by its `close` alone."""

    def __init__(self) -> None:
        self.servos: HeadServos | None = None
        self.eyes: list[EyeThread] = []
        self.world: EmulatedWorld | None = None
        self.settings = ExitStack()

    def close(self) -> None:
        """Bring the servos to rest, and release all; a second call does nothing."""
        servos, self.servos = self.servos, None
        eyes, self.eyes = self.eyes, []
        world, self.world = self.world, None
        try:
            if servos is not None:
                servos.close()
        finally:
            for eye in eyes:
                eye.close()
            if world is not None:
                world.close()
            self.settings.close()
