"""Look at a fingertip: `vergence gaze --target docs/examples/mediapipe_target.py:Fingertip`.

Needs `pip install mediapipe` and its model `hand_landmarker.task` in the current folder.
"""

import mediapipe as mp

from vergence.vision import Detection


class Fingertip:
    """The tip of the index finger of each hand."""

    def __init__(self):
        path = "hand_landmarker.task"
        self.hands = mp.tasks.vision.HandLandmarker.create_from_model_path(path)

    def detect(self, image, hint):
        """Find the fingertips in an image, blue, green and red."""
        height, width = image.shape[:2]
        picture = mp.Image(image_format=mp.ImageFormat.SRGB, data=image[..., ::-1].copy())
        tips = [hand[8] for hand in self.hands.detect(picture).hand_landmarks]
        return [Detection((width * tip.x, height * tip.y), sigma_px=3.0) for tip in tips]
