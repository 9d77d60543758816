"""Film files: GIF and WebP by Pillow, MP4 by OpenCV."""

import errno
import os
import tempfile
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Final

import cv2
import numpy as np
from PIL import Image as PillowImage

from vergence.envs.reading import Image
from vergence.errors import ConfigurationError
from vergence.files import atomic_file
from vergence.vision.image import suppress_opencv_log

SUFFIXES: Final = (".gif", ".mp4", ".webp")
"""Suffixes of films."""
_CODECS: Final = ("vp09", "mp4v")
"""Codecs of MP4, the first that OpenCV has: VP9, which browsers play; else MPEG-4."""
_PALETTE_FRAMES: Final = 8
"""Frames from which a GIF's palette is taken (chosen: all colours against time)."""
_GREYS: Final = 64
"""Greys of a GIF's palette (chosen: steps that are hardly seen, and hide the noise of cameras)."""
_LEAST_SATURATION: Final = 6
"""Difference of a pixel's channels from which it counts as coloured (chosen)."""
_WEBP_EFFORT: Final = 4
"""Effort of WebP's encoder, 0 to 6 (chosen: size against time)."""
_WEBP_QUALITY: Final = 80
"""Quality of WebP, 0 to 100 (chosen: no visible loss)."""


def check_film(path: Path) -> None:
    """Refuse, before any work is done, a film that cannot be written.

    Args:
        path: path of the film.

    Raises:
        ConfigurationError: its suffix is unknown, its folder is missing or cannot be written, or it
            is a folder.
    """
    if path.suffix.lower() not in SUFFIXES:
        raise ConfigurationError(f"record: expected FILE.gif, .mp4 or .webp, got {path}")
    try:
        with tempfile.TemporaryDirectory(prefix=".vergence-", dir=path.parent):
            pass
        if path.is_dir():
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise ConfigurationError(
            f"record: expected a file that can be written, got {path}: {reason}"
        ) from error


def write_film(
    path: Path,
    frame_at: Callable[[int], Image],
    durations_ms: Sequence[int],
    progress: Callable[[float], None] | None = None,
) -> None:
    """Write a film that repeats, atomically.

    Args:
        path: the file, of one of `SUFFIXES`; an existing one is replaced. Its folder must exist.
        frame_at: returns a frame by its index, (height, width, 3) RGB, of even sizes.
        durations_ms: time that each frame is shown, ms; in an MP4 a multiple of the first one's.
        progress: callback with the fraction done, after every frame.

    Raises:
        ConfigurationError: the film cannot be written.
    """

    def frames() -> Iterator[Image]:
        for k in range(len(durations_ms)):
            yield frame_at(k)
            if progress is not None:
                progress((k + 1) / len(durations_ms))

    try:
        with atomic_file(path) as partial:
            suffix = path.suffix.lower()
            if suffix == ".mp4":
                _write_mp4(partial, frames(), durations_ms)
                return
            pictures = (PillowImage.fromarray(frame) for frame in frames())
            if suffix == ".gif":
                palette = _palette(frame_at, len(durations_ms))
                pictures = (
                    one.quantize(palette=palette, dither=PillowImage.Dither.NONE)
                    for one in pictures
                )
            with partial.open("wb") as file:  # Pillow would leave it open after an exception
                next(pictures).save(
                    file,
                    format=suffix.removeprefix("."),
                    save_all=True,
                    append_images=pictures,
                    duration=list(durations_ms),
                    loop=0,
                    quality=_WEBP_QUALITY,
                    method=_WEBP_EFFORT,
                )
    except OSError as error:
        reason = error.strerror or error
        raise ConfigurationError(f"record: cannot write {path}: {reason}") from error


def _palette(frame_at: Callable[[int], Image], count: int) -> PillowImage.Image:
    """256 colours of a film: the saturated ones of some frames, and greys."""
    some = np.linspace(0, count - 1, _PALETTE_FRAMES).astype(int)
    pixels = np.concatenate([frame_at(k).reshape(-1, 3) for k in some])
    coloured = pixels[np.ptp(pixels, axis=1) > _LEAST_SATURATION]
    chosen = np.repeat(np.linspace(0, 255, _GREYS).round().astype(np.uint8)[:, None], 3, axis=1)
    if len(coloured):
        few = PillowImage.fromarray(coloured[None]).quantize(256 - _GREYS)
        colours = np.array(few.getpalette(), dtype=np.uint8).reshape(-1, 3)[: 256 - _GREYS]
        chosen = np.concatenate([chosen, colours])
    palette = PillowImage.new("P", (1, 1))
    palette.putpalette(chosen.tobytes())
    return palette


def _write_mp4(path: Path, frames: Iterator[Image], durations_ms: Sequence[int]) -> None:
    first = next(frames)
    for codec in _CODECS:
        with suppress_opencv_log():
            size = (first.shape[1], first.shape[0])
            code = cv2.VideoWriter.fourcc(*codec)
            writer = cv2.VideoWriter(str(path), code, 1000.0 / durations_ms[0], size)
        if writer.isOpened():
            break
    else:
        raise OSError("OpenCV has no encoder for it; expected .gif or .webp")
    try:
        for frame, duration in zip((first, *frames), durations_ms, strict=True):
            for _ in range(max(1, round(duration / durations_ms[0]))):
                writer.write(cv2.cvtColor(frame, cv2.COLOR_RGB2BGR))
    finally:
        writer.release()
