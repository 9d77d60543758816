"""What a robot tells while it runs, to whoever listens: a log, or a measurement."""

from vergence.envs.reading import Image, Reading, Truth
from vergence.models.parts import FloatArray
from vergence.recording.schema import LoggedCommand, LoggedDetection


class Listener:
    """Hears all that happens on a robot, and does nothing about it; others do some of it.

    Attributes:
        images: whether it takes the eyes' images.
    """

    images: bool = False

    def begin(self) -> None:
        """A trial begins: the next reading is that of its time zero."""

    def reading(self, reading: Reading, begun_s: float) -> None:
        """Hear a reading of one head.

        Args:
            reading: what the sensors report.
            begun_s: when the trial began, s of the clock.
        """

    def command(self, command: LoggedCommand) -> None:
        """Hear a command; what was sent must not change any more."""

    def joints(self, clock_s: float, positions: FloatArray, velocities: FloatArray) -> None:
        """Hear a measurement of the joints, see `LoggedJoints`; it must not change any more."""

    def truth(self, truth: Truth) -> None:
        """Hear what is true about one head."""

    def detection(self, found: LoggedDetection) -> None:
        """Hear what an eye saw in an image; its arrays must not change any more."""

    def image(self, eye: int, image: Image, exposed_s: float) -> None:
        """Hear an image of an eye; it must not change any more.

        Args:
            eye: 0 for left.
            image: (height, width) grey levels.
            exposed_s: when it was exposed, s of the clock.
        """

    def stopped(self, reason: str) -> None:
        """Hear the reason for which the head has been stopped."""
