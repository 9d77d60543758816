"""Look at a cup found by YOLO: `vergence gaze --target docs/examples/yolo_target.py:Cup`.

Needs `pip install ultralytics lap`; it fetches the weights at the first use.
"""

from ultralytics import YOLO

from vergence.vision import Detection


class Cup:
    """Cups, each with the number that YOLO's tracker gives it."""

    def __init__(self):
        self.model = YOLO("yolo11n.pt")

    def detect(self, image, hint):
        """Find the cups in an image, blue, green and red."""
        boxes = self.model.track(image, classes=[41], persist=True, verbose=False)[0].boxes
        numbers = boxes.id if boxes.is_track else [None] * len(boxes)
        return [
            Detection((u, v), sigma_px=0.05 * w, id=number and int(number), score=s, size_px=w)
            for (u, v, w, _h), s, number in zip(
                boxes.xywh.tolist(), boxes.conf.tolist(), numbers, strict=True
            )
        ]
