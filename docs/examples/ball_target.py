"""Look at an orange ball, by a detector of one's own.

vergence gaze --target docs/examples/ball_target.py:Ball
vergence view --target docs/examples/ball_target.py:Ball
"""

import cv2

from vergence.vision import Detection


class Ball:
    """The orange pixels, by their centre."""

    def detect(self, image, hint):
        """Find the ball in an image, blue, green and red."""
        hsv = cv2.cvtColor(image, cv2.COLOR_BGR2HSV)
        moments = cv2.moments(cv2.inRange(hsv, (5, 120, 60), (25, 255, 255)), binaryImage=True)
        area = moments["m00"]
        if area < 50:
            return []
        return [Detection((moments["m10"] / area, moments["m01"] / area), sigma_px=0.3)]
