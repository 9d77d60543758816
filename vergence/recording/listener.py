"""Interface for listeners to a running robot, such as a log or a measurement."""

from vergence.envs.reading import Image, Reading, Truth
from vergence.models.parts import FloatArray
from vergence.recording.schema import LoggedCommand, LoggedDetection


class RobotListener:
    """Receives all events of a running robot and ignores them; subclasses override some methods.

    Attributes:
        images: true to receive the eyes' images.
    """

    images: bool = False

    def begin(self) -> None:
        """Called at the start of a trial; the next reading is at its time zero."""

    def reading(self, reading: Reading, begun_s: float) -> None:
        """Receive a reading of one head.

        Args:
            reading: the sensors' reading.
            begun_s: time of the trial's start, s of the clock.
        """

    def command(self, command: LoggedCommand) -> None:
        """Receive a command; its `sent` array must not change afterwards."""

    def joints(self, clock_s: float, positions: FloatArray, velocities: FloatArray) -> None:
        """Receive a measurement of the joints, see `LoggedJoints`; it must not change later."""

    def truth(self, truth: Truth) -> None:
        """Receive the ground truth of one head."""

    def detection(self, detection: LoggedDetection) -> None:
        """Receive the detection in an image of an eye; its arrays must not change afterwards."""

    def image(self, eye: int, image: Image, exposed_s: float) -> None:
        """Receive an image of an eye; it must not change afterwards.

        Args:
            eye: 0 for left, 1 for right.
            image: (height, width) grey levels.
            exposed_s: time of the exposure, s of the clock.
        """

    def stopped(self, reason: str) -> None:
        """Receive the reason for a stop of the head."""
