"""Blobs of a colour in one image, to hundredths of a pixel."""

from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from vergence.models.camera import SRGB, Camera, light_table
from vergence.models.parts import FloatArray
from vergence.vision.detection import Detection
from vergence.vision.objects.targets import ColourTarget
from vergence.vision.optics import ray_table

ColourImage = NDArray[np.uint8]
"""(height, width, 3) blue, green and red levels."""
_HUE_TOLERANCE: Final = 10.0
"""Greatest difference of hue, in OpenCV's 2 degrees (chosen: white balance and shading against
other colours)."""
_PURE: Final = 0.8
"""Least saturation of what is surely of the colour, as a fraction of the target's (chosen: shading
and white balance)."""
_PALE: Final = 0.5
"""Least saturation at which a blob is connected, likewise (chosen: pale things and pale sides)."""
_PURE_SHARE: Final = 0.4
"""Least share of pure pixels in a blob with some; else these are blobs of their own if they score
higher (chosen: a thing with pale sides against a pure one before a pale wall of its hue)."""
_MATCH_POWER: Final = 12
"""Power of a pale blob's mean saturation, as a fraction of a pure one's, in its score (chosen: a
small orange ball before a large brown floor)."""
_LEAST_VALUE: Final = 60
"""Least value in HSV; the hue of darker pixels is noise (chosen)."""
_LEAST_AREA_PX: Final = 12
"""Least area of a blob, px^2 (chosen: above noise)."""
_MOST_BLOBS: Final = 6
"""Most candidates in an image, the largest first (chosen: time)."""
_LEAST_SCORE: Final = 0.1
"""Least score of a candidate, as a fraction of the best one's (chosen: time)."""
_NEAR_SHARE: Final = 0.2
"""Half a side of the part of an image that is searched around a hint, as a fraction of its width
(chosen: quick motions against time)."""
_FULL_PX: Final = 320
"""Greatest width that is always searched at full resolution, px (chosen: time)."""
_STUB: Final = 0.4
"""Half the width of parts that do not belong to a blob, as a fraction of half the blob's (chosen:
things beside it of its colour)."""
_ROUND: Final = 0.8
"""Least area of the largest disc in a blob without these parts, as a fraction of the area; else
they belong to it (chosen: balls, if stretched at the image's edge, against long things)."""
_LEAST_PART: Final = 0.1
"""Least area of a part of a blob, as a fraction of the largest part's (chosen: noise)."""
_MOST_HOLE: Final = 0.2
"""Greatest area of a hole that counts as covered, as a fraction of the part's around it (chosen:
highlights and prints)."""
_BAND_PX: Final = 2
"""Half the width of the band along a blob's outline in which pixels are covered in part, px
(chosen: lens blur, a short smear, and JPEG's halved chroma)."""
_RING_PX: Final = 3
"""Width of the surround beyond this band, px (chosen: enough pixels near the outline)."""
_MOST_PIXELS: Final = 2000
"""Most pixels from which a variance is taken (chosen: time)."""
_SHADING: Final = 0.2
"""Standard deviation of shading along the outline, as a fraction of the blob's light (chosen: a
ball under a lamp)."""
_LEAST_NOISE: Final = 0.003
"""Least standard deviation of light in a channel, of 1 (numerical: clean images)."""
_CORRELATED_PX: Final = 14.0
"""Number of neighbouring pixels whose background is alike (chosen: textures)."""
_CHANGE: Final = 0.3
"""Standard deviation of a position by the choice of the outline, as a fraction of what it moves by
when the outline is corrected (chosen: measured on balls in rooms)."""
_FLOOR_PX: Final = 0.03
"""Least standard deviation of a position, px (chosen: JPEG, and shading along the outline; measured
on balls in rooms)."""
_SMALL = np.ones((3, 3), np.uint8)


class ColourDetector:
    """Finds blobs of a colour; each pixel at an outline counts by the share of it that is covered.

    The share is linear in light: where a pixel lies between the blob's colour and that of its
    surround along Fisher's discriminant, which heeds shading, textures and noise. The position is
    that of the centre of a ball with this outline: the mean direction over the blob's solid angle.
    """

    def __init__(self, target: ColourTarget, camera: Camera) -> None:
        response = SRGB if camera.response is None else camera.response
        light = light_table(response) / 255.0
        srgb = light_table(SRGB) / 255.0
        self._light = light.astype(np.float32)
        self._levels = np.rint(np.interp(light, srgb, np.arange(256.0))).astype(np.uint8)
        rgb = np.array(target.rgb, np.uint8)
        hue, saturation, _value = cv2.cvtColor(rgb[None, None, ::-1], cv2.COLOR_BGR2HSV)[0, 0]
        self._hue, self._saturation = float(hue), float(saturation)
        self._camera = camera
        self._cone = _solid_angles(camera)

    def detect(self, image: ColourImage, hint: FloatArray | None = None) -> list[Detection]:
        """See `Detector.detect`; the score is from the blob's area and saturation."""
        height, width = image.shape[:2]
        found: list[Any] = []
        if hint is not None and np.isfinite(hint).all():
            reach = _NEAR_SHARE * width
            x0, y0 = np.clip(np.asarray(hint) - reach, 0, (width, height)).astype(int).tolist()
            x1, y1 = np.clip(np.asarray(hint) + reach, 0, (width, height)).astype(int).tolist()
            if min(x1 - x0, y1 - y0) > 2 * _SMALL.shape[0]:
                found = [
                    one
                    for one in self._blobs(image[y0:y1, x0:x1], x0, y0)
                    if (one[1] > x0 or x0 == 0) and (one[1] + one[3].shape[1] < x1 or x1 == width)
                    if (one[2] > y0 or y0 == 0) and (one[2] + one[3].shape[0] < y1 or y1 == height)
                ]
        return [self._measure(image, *one) for one in found or self._blobs(image, 0, 0)]

    def _blobs(self, image: ColourImage, x0: int, y0: int) -> list[Any]:
        """Score, box and mask of the best blobs in a part of an image from a pixel on.

        More than the surround of a hint is searched at half the resolution.
        """
        full = max(2 * _NEAR_SHARE * self._camera.width + 1, _FULL_PX)
        step = 2 if image.shape[1] > full else 1
        if step == 2:
            height, width = image.shape[0] // 2, image.shape[1] // 2
            part = image[: 2 * height, : 2 * width]
            image = np.asarray(cv2.resize(part, (width, height), interpolation=cv2.INTER_AREA))
        smooth: Any = cv2.GaussianBlur(image, (3, 3) if step == 2 else (5, 5), 1.0 / step)
        hsv: Any = cv2.cvtColor(cv2.LUT(smooth, self._levels), cv2.COLOR_BGR2HSV)
        saturation = hsv[..., 1]
        mask: Any = np.zeros(saturation.shape, np.uint8)
        for turn in (-180.0, 0.0, 180.0):  # OpenCV's hue is in 2 degrees
            low, high = self._hue + turn - _HUE_TOLERANCE, self._hue + turn + _HUE_TOLERANCE
            if low < 180.0 and high >= 0.0:
                least = (low, _PALE * self._saturation, _LEAST_VALUE)
                mask |= cv2.inRange(hsv, least, (high, 255, 255))
        pure = _PURE * self._saturation
        labels, stats, scores, share = _parts(mask, saturation, pure, step)
        found = [(labels, stats, scores)]
        mixed = (share > 0.0) & (share < _PURE_SHARE)
        if mixed.any():
            mask &= (saturation >= pure) & mixed[labels]
            parts, part_stats, part_scores, _share = _parts(mask, saturation, pure, step)
            owner = np.zeros(len(part_scores), int)
            owner[parts[parts > 0]] = labels[parts > 0]
            best = np.zeros(len(scores))
            np.maximum.at(best, owner, part_scores)
            apart = mixed & (best >= scores)
            scores[apart] = 0.0
            part_scores[~apart[owner]] = 0.0
            found.append((parts, part_stats, part_scores))
        least_score = _LEAST_SCORE * max(scores.max() for _labels, _stats, scores in found)
        blobs = []
        for labels, stats, scores in found:
            for i in np.argsort(-scores)[:_MOST_BLOBS].tolist():
                if scores[i] > least_score:
                    x, y, width, height = stats[i, :4].tolist()
                    blob = (labels[y : y + height, x : x + width] == i).astype(np.uint8)
                    whole = blob.repeat(step, 0).repeat(step, 1)
                    blobs.append((float(scores[i]), x0 + step * x, y0 + step * y, whole))
        return sorted(blobs, key=lambda each: -each[0])[:_MOST_BLOBS]

    def _measure(self, image: ColourImage, score: float, x: int, y: int, blob: Any) -> Detection:
        blob = blob[: image.shape[0] - y, : image.shape[1] - x]
        height, width = blob.shape
        reach = _BAND_PX + _RING_PX + 4
        rows = slice(max(y - reach, 0), min(y + height + reach, image.shape[0]))
        columns = slice(max(x - reach, 0), min(x + width + reach, image.shape[1]))
        light: Any = cv2.LUT(image[rows, columns], self._light)
        solid: Any = np.zeros(light.shape[:2], np.uint8)
        at = (slice(y - rows.start, y - rows.start + height),
              slice(x - columns.start, x - columns.start + width))  # fmt: skip
        solid[at] = blob
        solid = _compact(_filled(solid))
        v, u = np.mgrid[rows, columns].astype(np.float32)
        share, variance, band = _shares(light, solid)
        first = _centroid(share, u, v)
        half = cv2.morphologyEx((share > 0.5).astype(np.uint8), cv2.MORPH_OPEN, _SMALL)
        if half.any():  # now with the outline at a share of a half
            share, variance, band = _shares(light, _filled(half))
        centre = _centroid(share, u, v)
        total = max(float(share.sum()), 1.0)
        size_px = float(np.sqrt(4.0 * total / np.pi))
        scatter = [
            float((variance * (a - c) ** 2)[band].sum()) / total**2
            for a, c in zip((u, v), centre, strict=True)
        ]
        at_edge = x <= 1 or y <= 1 or x + width >= image.shape[1] - 1
        at_edge |= y + height >= image.shape[0] - 1
        sigma = np.sqrt(np.array(scatter) + (_CHANGE * (centre - first)) ** 2 + _FLOOR_PX**2)
        if at_edge:  # cut off there
            sigma = np.maximum(sigma, 0.25 * size_px)
        axis = np.tensordot(share, self._cone[rows, columns], 2)
        centre = self._camera.project(axis[None].astype(float))[0]
        return Detection(centre, sigma, None, float(score), size_px=size_px)


def _solid_angles(camera: Camera) -> NDArray[np.float32]:
    """Unit vector along each pixel's ray times the pixel's solid angle, (height, width, 3)."""
    rays = ray_table(camera, 1, 0).astype(float)
    down, right = np.gradient(rays, axis=(0, 1))
    area = np.abs(right[..., 0] * down[..., 1] - right[..., 1] * down[..., 0])
    full = np.dstack([rays, np.ones(area.shape)])
    return np.asarray(full * (area / (full**2).sum(axis=2) ** 2)[..., None], np.float32)


def _parts(mask: Any, saturation: Any, pure: float, step: int) -> tuple[Any, Any, Any, Any]:
    """Labels, statistics and scores of the connected parts of a mask, and shares that are pure."""
    part = cv2.morphologyEx(mask, cv2.MORPH_OPEN, _SMALL)
    count, labels, stats, _centres = cv2.connectedComponentsWithStats(part)
    within = np.flatnonzero(part)
    which, values = labels.reshape(-1)[within], saturation.reshape(-1)[within]
    areas = np.maximum(stats[:, cv2.CC_STAT_AREA], 1.0)
    match = np.minimum(np.bincount(which, values, count) / areas / pure, 1.0)
    scores = np.sqrt(areas / mask.size) * match**_MATCH_POWER
    scores[areas < _LEAST_AREA_PX / step**2] = scores[0] = 0.0
    return labels, stats, scores, np.bincount(which, values >= pure, count) / areas


def _centroid(share: Any, u: Any, v: Any) -> FloatArray:
    total = max(float(share.sum()), 1.0)
    return np.array([float((share * u).sum()), float((share * v).sum())]) / total


def _filled(solid: Any) -> Any:
    """A mask's large parts, with their small holes."""
    outlines, tree = cv2.findContours(solid, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    areas = np.array([cv2.contourArea(each) for each in outlines])
    if not len(areas):
        return solid
    parent = tree[0, :, 3]
    small = (parent < 0) & (areas < _LEAST_PART * areas[parent < 0].max())
    holes = (parent >= 0) & ~small[parent] & (areas < _MOST_HOLE * areas[parent])
    for which, value in ((small, 0), (holes, 1)):
        for i in np.flatnonzero(which).tolist():
            cv2.drawContours(solid, outlines, i, value, cv2.FILLED)
    return solid


def _compact(solid: Any) -> Any:
    """A mask without the thin parts that stick out of it, if it is a disc then."""
    depth = _depth_px(solid)
    radius = float(depth.max())
    least = _STUB * radius
    rest = solid & (_depth_px((depth <= least).astype(np.uint8)) <= least)
    return rest if np.pi * radius**2 >= _ROUND * cv2.countNonZero(rest) else solid


def _depth_px(solid: Any) -> Any:
    """Distance of each pixel within a mask, which goes on outside of the image, to its outline."""
    wide = cv2.copyMakeBorder(solid, 1, 1, 1, 1, cv2.BORDER_REPLICATE)
    return cv2.distanceTransform(wide, cv2.DIST_L2, 3)[1:-1, 1:-1]


def _shares(light: Any, solid: Any) -> tuple[Any, Any, Any]:
    """Share of each pixel that a blob covers, its variance, and the band along the outline."""
    inner, outer = _depth_px(solid), _depth_px(1 - solid)
    core = inner > min(_BAND_PX, 0.7 * float(inner.max()))
    band, ring = (outer <= _BAND_PX) & ~core, outer > _BAND_PX
    ring &= outer <= _BAND_PX + _RING_PX
    pixels_in, pixels_out = _some(light, core), _some(light, ring)
    if not len(pixels_in) or not len(pixels_out):
        return solid.astype(np.float32), np.full(solid.shape, 0.25, np.float32), band
    colour, surround = pixels_in.mean(axis=0), pixels_out.mean(axis=0)
    spread = np.cov(pixels_in.T, bias=True) + np.cov(pixels_out.T, bias=True)
    spread += _LEAST_NOISE**2 * np.eye(3) + _SHADING**2 * np.outer(colour, colour)
    axis = np.linalg.solve(spread, colour - surround)
    axis = (axis / (axis @ (colour - surround))).astype(np.float32)
    value: Any = cv2.transform(light, axis[None])
    low, high = _local_mean(value, ring), _local_mean(value, core)
    height = np.maximum(high - low, 0.3)
    share = np.where(band, (value - low) / height, core)
    if share.sum() < 1.0:  # nothing of the blob's colour is left
        return solid.astype(np.float32), np.full(solid.shape, 0.25, np.float32), band
    noise_in = float(np.var(_some(value - high, core)))
    noise_out = float(np.var(_some(value - low, ring)))
    half = np.clip(share, 0.0, 1.0)
    variance = half**2 * noise_in + (1.0 - half) ** 2 * noise_out
    return share.astype(np.float32), _CORRELATED_PX * variance / height**2, band


def _some(values: Any, mask: Any) -> Any:
    """At most some thousand of the values under a mask."""
    places = np.flatnonzero(mask)
    places = places[:: len(places) // _MOST_PIXELS + 1]
    return values.reshape(mask.size, *values.shape[2:])[places]


def _local_mean(values: Any, mask: Any) -> Any:
    """Mean of the values under a mask near each pixel; that of all of them where none is near."""
    size = (2 * (_BAND_PX + _RING_PX) + 1,) * 2
    weight = mask.astype(np.float32)
    count: Any = cv2.blur(weight, size)
    mean = cv2.blur(values * weight, size) / np.maximum(count, 1e-6)
    return np.where(count > 1e-4, mean, _some(values, mask).mean())
