"""Following a target through one eye's images: image and prediction in, pixel out."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vergence.vision.detection import Detection, Detector


class Tracker:
    """Looks for a target near where it is expected, and in the whole image if it is not there.

    Args:
        detector: what finds the target in an image.
    """

    def __init__(self, detector: Detector) -> None:
        self._detector = detector
        self.forget()

    def forget(self) -> None:
        """Lose the track: the next image is searched as a whole."""
        self._last: Detection | None = None
        self._motion = np.zeros(2)

    def find(
        self,
        image: NDArray[np.uint8],
        predicted_px: ArrayLike | None = None,
        *,
        search: bool = True,
    ) -> NDArray[np.float64] | None:
        """Find the target in the next image.

        Args:
            image: (height, width) grey levels.
            predicted_px: (2,) where the measured point is expected; None for where it was last,
                moved on as it moved from the image before.
            search: whether to search the whole image where the target is not tracked.

        Returns:
            (2,) the measured point, px; None where no complete target can be read.
        """
        found = None
        if self._last is not None:
            if predicted_px is None:
                predicted_px = self._last.point_px + self._motion
            found = self._detector.track(image, predicted_px, self._last)
        if found is None and search:
            found = self._detector.detect(image)
        if found is None:
            self.forget()
            return None
        if self._last is not None:
            self._motion = found.point_px - self._last.point_px
        self._last = found
        return found.point_px
