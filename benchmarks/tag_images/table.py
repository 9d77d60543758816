"""Run methods on varied photographs and tabulate their scores."""

import statistics
import time
import zlib
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pandas as pd

from benchmarks.tag_images.catalogue import AS_IT_IS, VARIATIONS
from benchmarks.tag_images.methods import Method
from benchmarks.tag_images.photographs import KnownTag, Photograph
from benchmarks.tag_images.scores import Score, score
from benchmarks.tag_images.variations import Variation, Varied, vary

TOTAL = "total"
WHOLE = "whole photograph"


def run(
    photographs: Sequence[Photograph],
    chosen: Sequence[Sequence[int]],
    methods: Sequence[Method],
    variations: Sequence[Variation],
    draws: int,
    say: Callable[[str], None],
) -> pd.DataFrame:
    """Run every method on every variation of every tag.

    Args:
        photographs: photographs with tags at the median of the methods.
        chosen: indices of the tags of each photograph to vary; the others only count as known.
        methods: methods to run.
        variations: variations to make.
        draws: number of draws of each random variation of each tag.
        say: receives messages on the progress.

    Returns:
        Table with a row for each tag, variation, draw and method.
    """
    rows: list[dict[str, object]] = []
    count, done = sum(map(len, chosen)), 0
    for photograph, indices in zip(photographs, chosen, strict=True):
        whole = {method.name: method.detect(photograph.image) for method in methods}
        for index in indices:
            tag = photograph.tags[index]
            about = {"photograph": photograph.name, "tag": index, "id": tag.id}
            for k, method in enumerate(methods):
                got = score(whole[method.name], tag, photograph.tags, method.ordered)
                if index != indices[0]:  # once a photograph
                    got = replace(got, wrong=(), stray=())
                rows.append(about | _row(WHOLE, 0, method, k, got))
            for variation in variations:
                if tag.edge_px < variation.least_edge_px:
                    continue
                for draw in range(1 if variation == AS_IT_IS else draws):
                    # separate seeds, so that a row does not depend on the other rows
                    seed = zlib.crc32(f"{photograph.name}/{index}/{variation.name}/{draw}".encode())
                    varied = vary(photograph.image, tag, variation, np.random.default_rng(seed))
                    moved = _moved(tag, varied)
                    known = [_moved(other, varied) for other in photograph.tags]
                    for k, method in enumerate(methods):
                        got = score(method.detect(varied.image), moved, known, method.ordered)
                        rows.append(about | _row(variation.name, draw, method, k, got))
            done += 1
            say(f"{done} of {count} tags")
    return pd.DataFrame(rows)


def _moved(tag: KnownTag, varied: Varied) -> KnownTag:
    return KnownTag(tag.id, varied.mapped(tag.corners_px), varied.mapped(tag.centre_px))


def _row(variation: str, draw: int, method: Method, order: int, got: Score) -> dict[str, object]:
    return {
        "variation": variation,
        "draw": draw,
        "method": method.name,
        "order": order,
        "found": got.found,
        "centre_error_px": got.centre_error_px,
        "corner_error_px": got.corner_error_px,
        "wrong": len(got.wrong),
        "wrong_ids": " ".join(map(str, got.wrong)),
        "stray": len(got.stray),
    }


def summary(rows: pd.DataFrame) -> pd.DataFrame:
    """Table with a row for each variation and method, and totals over all variations.

    Args:
        rows: table returned by `run`.

    Returns:
        Table with `tags`, `rate`, root mean square errors of found tags, root mean square errors
        in the images in which every method finds the tag (`shared`), and numbers of false
        detections, `wrong` and `stray`; see `benchmarks.tag_images.scores`.
    """
    every = rows.groupby(["photograph", "tag", "variation", "draw"])["found"].transform("all")
    rows = rows.assign(every=every)
    varied = rows[rows["variation"] != WHOLE]
    parts = [
        *sorted(
            rows.groupby(["variation", "method"], sort=False),
            key=lambda one: _order(str(one[0][0])),
        ),
        *(((TOTAL, name), part) for name, part in varied.groupby("method", sort=False)),
    ]
    table = [
        {
            "variation": variation,
            "method": method,
            "tags": len(part),
            "rate": float(part["found"].mean()),
            "centre_rms_px": _rms(part["centre_error_px"]),
            "corner_rms_px": _rms(part["corner_error_px"]),
            "shared": int(part["every"].sum()),
            "shared_centre_rms_px": _rms(part.loc[part["every"], "centre_error_px"]),
            "shared_corner_rms_px": _rms(part.loc[part["every"], "corner_error_px"]),
            "wrong": int(part["wrong"].sum()),
            "stray": int(part["stray"].sum()),
        }
        for (variation, method), part in parts
    ]
    return pd.DataFrame(table)


def _order(variation: str) -> int:
    """Position of a variation in the table, as the first tag may lack some variations."""
    names = [WHOLE, *(one.name for one in VARIATIONS)]
    return names.index(variation)


def _rms(errors: "pd.Series[float]") -> float:
    kept = errors.dropna().to_numpy()
    return float(np.sqrt(np.mean(kept**2))) if kept.size else float("nan")


def times_ms(
    photographs: Sequence[Photograph], methods: Sequence[Method], repeats: int
) -> dict[str, float]:
    """Detection time of each method: mean over whole photographs of the median of repeats, ms."""
    taken: dict[str, list[list[float]]] = {method.name: [] for method in methods}
    for photograph in photographs:
        for method in methods:
            taken[method.name].append([])
        # in turns, so that other load of the machine affects all methods alike
        for _ in range(repeats):
            for method in methods:
                start = time.perf_counter()
                method.detect(photograph.image)
                taken[method.name][-1].append(1e3 * (time.perf_counter() - start))
    return {
        name: statistics.fmean(statistics.median(one) for one in each)
        for name, each in taken.items()
    }
