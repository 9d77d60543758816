"""Resources that a plant holds open: the servos' line, the cameras, an emulated head's world."""

from vergence.hardware.drive import DriveThread
from vergence.hardware.emulator.client import WorldClient
from vergence.hardware.eyes import HeadEyes


class OpenedHead:
    """Servos, eyes and world of an open plant; a finalizer of the plant calls its `close`.

    Args:
        eyes: the eyes, still closed.
    """

    def __init__(self, eyes: HeadEyes) -> None:
        self.eyes = eyes
        self.drive: DriveThread | None = None
        self.world: WorldClient | None = None

    def close(self) -> None:
        """Stop the servos at once and release everything; a second call does nothing."""
        drive, self.drive = self.drive, None
        world, self.world = self.world, None
        try:
            if drive is not None:
                drive.close()
        finally:
            self.eyes.close()
            if world is not None:
                world.close()
