"""Look at an orange ball, by a detector of one's own.

vergence gaze --target docs/examples/ball_target.py:Ball
vergence view --target docs/examples/ball_target.py:Ball
"""

import cv2

from vergence.vision import Detection


class Ball:
    """The largest orange patch, by its centre."""

    def detect(self, image, hint):
        """Find it in an image, blue, green and red."""
        hsv = cv2.cvtColor(image, cv2.COLOR_BGR2HSV)
        mask = cv2.inRange(hsv, (5, 120, 60), (25, 255, 255))
        patches, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
        patches = [patch for patch in patches if cv2.contourArea(patch) > 50]
        return [
            Detection(cv2.minEnclosingCircle(patch)[0], 0.5, score=cv2.contourArea(patch))
            for patch in patches
        ]
