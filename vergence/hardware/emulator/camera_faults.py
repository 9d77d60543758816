"""Effects of camera faults on the images of both eyes."""

from collections.abc import Iterable

import numpy as np

from vergence.envs.reading import Image
from vergence.hardware.emulator.fault import Fault
from vergence.models.parts import EYE_NAMES


class CameraFaults:
    """Applies the active faults of the cameras to their images and times.

    Args:
        rng: draws the images that a fault with a probability affects.
    """

    def __init__(self, rng: np.random.Generator) -> None:
        self._rng = rng
        self._on: tuple[Fault, ...] = ()
        self._old: list[Image | None] = [None for _ in EYE_NAMES]

    def set_active(self, faults: Iterable[Fault]) -> None:
        """Replace the active faults."""
        self._on = tuple(faults)

    @property
    def right_exposure_delay_s(self) -> float:
        """Extra delay of the right camera's exposures, s."""
        return sum(fault.value for fault in self._on if fault.what == "out-of-step")

    def send_delay_s(self, eye: int) -> float:
        """Extra delay at which an eye's images are sent, s."""
        return sum(fault.value for fault in self._of(eye, "late"))

    def has_ended(self, eye: int) -> bool:
        """True if an eye's stream is closed."""
        return bool(self._of(eye, "ended"))

    def apply_to_image(self, eye: int, new: Image) -> Image | None:
        """Apply the faults to an eye's new image; None if no image is sent."""
        old = self._old[eye]
        if old is not None and self._of(eye, "frozen"):
            new = old
        self._old[eye] = new = new.copy()  # the caller reuses the array for the next image
        if self._of(eye, "mirrored"):
            new = new[:, ::-1]
        if self._of(eye, "upside-down"):
            new = new[::-1, ::-1]
        if self._of(eye, "stalled") or self._falls(eye, "dropped"):
            return None
        if old is not None and self._falls(eye, "torn"):
            middle = len(new) // 2
            return np.concatenate([new[:middle], old[middle:]])
        return new

    def _of(self, eye: int, what: str) -> list[Fault]:
        return [fault for fault in self._on if fault.what == what and fault.affects(eye)]

    def _falls(self, eye: int, what: str) -> bool:
        return any(self._rng.random() < fault.probability for fault in self._of(eye, what))
