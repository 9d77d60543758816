"""Scores of detections: found tags, their errors, false detections.

A tag is found if a detection with its id has its centre within `near_px` of the tag. A detection is
false if no known tag with its id is there. Known tags are those of the text file, and those that
two voters find in the unvaried photograph, since the text files do not list every tag. A false
detection counts as wrong if no known tag in the photograph has its id, else as stray. If text files
leave tags out, either may still be a real tag: look at the list that ``--json`` keeps. For images
without any tag see `benchmarks.false_positives`.

Corners are compared in the order of the target; corners of other methods in the best-fitting order,
clockwise or counter-clockwise.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from benchmarks.tag_images.methods import Found, Method
from benchmarks.tag_images.photographs import KnownTag, Photograph, edge

NEAR_PX = 2.0
NEAR_EDGES = 0.1
"""Tolerances of a centre, px and tag edges; the larger of both applies."""
_VOTERS = 2
"""Least number of voters for a median to define a tag."""


@dataclass(frozen=True)
class Score:
    """Score of a method on one tag of one image."""

    found: bool
    centre_error_px: float
    """nan if it is not found."""
    corner_error_px: float
    """Root mean square distance over the four corners; nan if it is not found."""
    wrong: tuple[int, ...]
    """Ids of false detections that no known tag in the photograph has."""
    stray: tuple[int, ...]
    """Ids of false detections that a known tag elsewhere in the photograph has."""


def near_px(edge_px: float) -> float:
    """Tolerance of the centre of a tag, px."""
    return max(NEAR_PX, NEAR_EDGES * edge_px)


def ordered_as(
    corners_px: NDArray[np.float64], goal_px: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Corners in the order that fits `goal_px` best, in either direction; shape (4, 2)."""
    orders = [np.roll(way, k, axis=0) for way in (corners_px, corners_px[::-1]) for k in range(4)]
    return min(orders, key=lambda order: float(np.sum((order - goal_px) ** 2)))


def score(found: Sequence[Found], tag: KnownTag, known: Sequence[KnownTag], ordered: bool) -> Score:
    """Score of a method on one tag of one image.

    Args:
        found: detections of the method in the image.
        tag: the tag to find, in coordinates of the image.
        known: all known tags, in coordinates of the image.
        ordered: True if the method's corners have the order of the target.
    """
    same = [one for one in found if one.id == tag.id]
    off = [float(np.linalg.norm(one.centre_px - tag.centre_px)) for one in same]
    false = [one.id for one in found if not any(_is(one, other) for other in known)]
    ids = {other.id for other in known}
    stray = tuple(number for number in false if number in ids)
    wrong = tuple(number for number in false if number not in ids)
    if not off or min(off) > near_px(tag.edge_px):
        return Score(False, np.nan, np.nan, wrong, stray)
    best = same[int(np.argmin(off))]
    corners = best.corners_px if ordered else ordered_as(best.corners_px, tag.corners_px)
    square = np.sum((corners - tag.corners_px) ** 2, axis=1)
    return Score(True, min(off), float(np.sqrt(square.mean())), wrong, stray)


def _is(found: Found, tag: KnownTag) -> bool:
    near = max(near_px(tag.edge_px), 0.5 * edge(found.corners_px))
    return found.id == tag.id and float(np.linalg.norm(found.centre_px - tag.centre_px)) < near


def voted(photograph: Photograph, methods: Sequence[Method]) -> Photograph:
    """Photograph with its tags at the median of the methods' detections.

    Tags that the text file does not list, but two voters find, are appended to those of the file.
    """
    seen = [(method.voter, method.detect(photograph.image)) for method in methods]
    fine = [one for one, method in zip(seen, methods, strict=True) if method.refined]
    tags = [_voted(tag, fine) for tag in photograph.tags]
    for one in (one for _, found in seen for one in found):
        unlisted = KnownTag(one.id, one.corners_px, one.centre_px)
        if len(_votes(unlisted, seen)) >= _VOTERS and not any(_is(one, tag) for tag in tags):
            tags.append(_voted(unlisted, fine))
    return replace(photograph, tags=tuple(tags))


def _votes(
    tag: KnownTag, seen: Sequence[tuple[str, list[Found]]]
) -> dict[str, list[NDArray[np.float64]]]:
    """Votes for a tag by voter: centre and corners found by each of its methods, shape (5, 2)."""
    votes: dict[str, list[NDArray[np.float64]]] = {}
    for voter, found in seen:
        same = [one for one in found if one.id == tag.id]
        same.sort(key=lambda one: float(np.linalg.norm(one.centre_px - tag.centre_px)))
        if same and np.linalg.norm(same[0].centre_px - tag.centre_px) <= near_px(tag.edge_px):
            corners = ordered_as(same[0].corners_px, tag.corners_px)
            votes.setdefault(voter, []).append(np.vstack([same[0].centre_px, corners]))
    return votes


def _voted(tag: KnownTag, seen: Sequence[tuple[str, list[Found]]]) -> KnownTag:
    votes = _votes(tag, seen)
    if len(votes) < _VOTERS:
        return tag
    points = np.median([np.median(voter, axis=0) for voter in votes.values()], axis=0)
    return replace(tag, centre_px=points[0], corners_px=points[1:])
