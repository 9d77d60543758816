"""Faces in one image, by a network in the form of YuNet or BlazeFace."""

import math
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from vergence.errors import ConfigurationError
from vergence.models.camera import Camera
from vergence.models.parts import FloatArray
from vergence.vision.detection import Detection
from vergence.vision.objects.targets import FaceTarget

_SIGMA: Final = 0.01
"""Standard deviation of a face's position, as a fraction of its width (chosen: scatter of all
networks on a photograph that is shifted, resized and noisy)."""
_SIGMA_PX: Final = 0.5
"""The same in pixels of the network's own image (chosen: likewise)."""
_SCORE: Final = 0.6
"""Least score of a face (chosen: OpenCV's example has 0.9 for photographs, webcams need less)."""
_PICTURE_PX: Final = 640
"""Longer side at which a photograph is searched, px (chosen: what the networks are made for)."""
_OVERLAP: Final = 0.3
"""Overlap above which two boxes are one face, area of both over that of either (chosen: OpenCV's
and MediaPipe's default)."""
_BLAZE_FORMS: Final = (
    (("regressors", "classificators"), 128, ((16, 2), (8, 6))),
    (("regressors", "classificators"), 256, ((16, 2), (8, 6))),
    (("reshaped_regressor_face_4", "reshaped_classifier_face_4"), 192, ((48, 1),)),
)
"""BlazeFace's forms: outputs, side of its image, and sides of its grids with boxes per cell: front
and short range, back, full range (physical: the published networks)."""


class FaceDetector:
    """Finds faces; the position is the mean of eyes, nose and mouth.

    Raises:
        ConfigurationError: the file is no such network.
    """

    def __init__(self, target: FaceTarget, camera: Camera) -> None:
        self._blaze: _Blaze | None = None
        try:
            if target.model.lower().endswith(".tflite"):
                self._blaze = _Blaze(target.model)
            else:
                self._yunet = cv2.FaceDetectorYN.create(target.model, "", camera.size, _SCORE)
                self.detect(np.zeros((camera.height, camera.width, 3), np.uint8))
        except (cv2.error, ValueError) as error:
            raise ConfigurationError(
                f"target {target}: expected a network in the form of YuNet, such as OpenCV's "
                "face_detection_yunet_2023mar.onnx, or of BlazeFace, such as "
                f"face_detection_short_range.tflite: {' '.join(str(error).split())[-120:]}"
            ) from error

    def detect(self, image: NDArray[np.uint8], hint: FloatArray | None = None) -> list[Detection]:
        """See `Detector.detect`."""
        if self._blaze is not None:
            return self._blaze.detect(image)
        faces: Any = self._yunet.detect(image)[1]
        rows = np.empty((0, 15)) if faces is None else np.asarray(faces, float)
        return [
            _face(row[4:14].reshape(5, 2).mean(axis=0), float(row[2]), float(row[14]), 1.0)
            for row in rows
        ]


def face_from_middle(target: FaceTarget, picture: NDArray[np.uint8]) -> FloatArray:
    """Place (2,) of the best face of a photograph, right and down from its middle, px.

    Raises:
        ConfigurationError: the file is no such network, or finds no face.
    """
    scale = min(_PICTURE_PX / max(picture.shape), 1.0)
    small = np.asarray(
        cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA), np.uint8
    )
    size = small.shape[1], small.shape[0]
    faces = FaceDetector(target, Camera(size=size, matrix=np.eye(3))).detect(small)
    if not faces:
        raise ConfigurationError(
            f"scene: expected a photograph in which {target} finds a face, got one without"
        )
    best = max(faces, key=lambda one: one.score)
    return np.asarray((best.pixel - 0.5 * (np.array(size) - 1.0)) / scale)


def _face(pixel: FloatArray, width_px: float, score: float, scale: float) -> Detection:
    sigma_px = math.hypot(_SIGMA * width_px, _SIGMA_PX / scale)
    return Detection(pixel, np.full(2, sigma_px), None, score, size_px=width_px)


class _Blaze:
    """BlazeFace, https://arxiv.org/abs/1907.05047: boxes and six landmarks about cells of grids."""

    def __init__(self, file: str) -> None:
        # OpenCV's new engine gives one output alone
        self._net = cv2.dnn.readNetFromTFLite(file, cv2.dnn.ENGINE_CLASSIC)
        layers = set(self._net.getLayerNames())
        for self._outputs, self._side, grids in _BLAZE_FORMS:
            cells = [
                np.repeat((np.indices((n, n))[::-1].reshape(2, -1).T + 0.5) / n, k, axis=0)
                for n, k in grids
            ]
            self._anchors = np.concatenate(cells)
            if layers.issuperset(self._outputs):
                boxes, _scores = self._run(np.zeros((self._side, self._side, 3), np.uint8))
                if boxes.shape == (len(self._anchors), 16):
                    return
        raise ValueError("outputs of another form")

    def _run(self, square: NDArray[np.uint8]) -> tuple[FloatArray, FloatArray]:
        size, middle = (self._side, self._side), (127.5, 127.5, 127.5)
        self._net.setInput(cv2.dnn.blobFromImage(square, 1.0 / 127.5, size, middle, swapRB=True))
        boxes, raw = (np.asarray(each[0], float) for each in self._net.forward(self._outputs))
        return boxes, 1.0 / (1.0 + np.exp(-raw[:, 0].clip(-50.0, 50.0)))

    def detect(self, image: NDArray[np.uint8]) -> list[Detection]:
        """Faces in an image, which is padded to a square."""
        height, width = image.shape[:2]
        scale = self._side / max(height, width)
        size = (math.ceil(scale * width), math.ceil(scale * height))
        small = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
        square = np.zeros((self._side, self._side, 3), np.uint8)
        square[: size[1], : size[0]] = small
        values, scores = self._run(square)
        likely = scores >= _SCORE
        points = values[likely].reshape(-1, 8, 2)  # centre, size, eyes, nose, mouth, ears
        scores = scores[likely]
        points[:, [0, 2, 3, 4, 5, 6, 7]] += self._side * self._anchors[likely, None]
        points = points * (width / size[0], height / size[1])
        boxes = np.column_stack([points[:, 0] - 0.5 * points[:, 1], points[:, 1]])
        kept: Any = cv2.dnn.NMSBoxes(boxes.tolist(), scores.tolist(), _SCORE, _OVERLAP)
        found = []
        for i in np.asarray(kept, int).ravel().tolist():
            apart = np.linalg.norm(points[:, 0] - points[i, 0], axis=1)
            weights = scores * (apart < _OVERLAP * points[i, 1, 0])  # their mean scatters less
            mean = np.average(points, axis=0, weights=weights)
            centre, width_px = mean[2:6].mean(axis=0) - 0.5, float(mean[1, 0])
            found.append(_face(centre, width_px, float(scores[i]), scale))
        return found
