"""Find targets in pairs of photographs and triangulate them."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from vergence.errors import ConfigurationError, VergenceError
from vergence.models.camera import parse_response
from vergence.models.head import HeadModel
from vergence.models.head_file import load_head
from vergence.models.parts import EYE_NAMES, EYES, FloatArray
from vergence.perception.edges import describe_wrong_edges
from vergence.perception.joint_angles import eyes_move, read_joint_angles
from vergence.perception.locate_config import LocateConfig
from vergence.perception.located import LocatedTarget, locate_target
from vergence.perception.pairing import pair_up
from vergence.perception.photographs import join_first_names, remark_on_orientation_tags
from vergence.perception.spacing import EdgeSpacing, measure_spacing
from vergence.perception.target_finder import (
    Photograph,
    PhotographNotes,
    TargetFinder,
    parse_targets,
    target_key,
)
from vergence.triangulation import Noise
from vergence.vision import Camera, Detection
from vergence.vision.targets import AprilTag, PlanarTarget

MAX_GAP_PX: Final = 2.0
"""Largest distance between the lines of sight of a calibrated pair, px (chosen: false against
missed remarks)."""


class MissedTarget(NamedTuple):
    """A target that could not be triangulated: one image lacks it, or shows it twice."""

    pair: str
    target: PlanarTarget
    seen_in: str
    """`left` or `right` if only that image has the target; `twice` if one has it more than once."""


class ShownPair(NamedTuple):
    """The pair that is drawn in the picture."""

    left: Photograph
    right: Photograph


@dataclass(frozen=True, kw_only=True, eq=False)
class LocateResult:
    """Targets located in all pairs."""

    config: LocateConfig
    head: HeadModel
    angles: dict[str, FloatArray]
    """(7,) joint angles by pair, rad."""
    pairs: tuple[str, ...]
    """Names of the pairs that could be read."""
    located: tuple[LocatedTarget, ...]
    missed: tuple[MissedTarget, ...]
    remarks: tuple[str, ...]
    """Notes for the user, one line each: targets that are in no image although others are, clipped
    white, a response that seems wrong."""
    unpaired: tuple[Path, ...]
    """Images without a partner."""
    failures: tuple[str, ...]
    """Images that could not be read, one line each."""
    shown: ShownPair
    """First pair in which a target was located, else the first with a detection in either image,
    else the first."""

    @property
    def any_triangulated(self) -> bool:
        """True if any point was triangulated."""
        return any(one.valid.any() for one in self.located)

    def located_by_target(self) -> list[list[LocatedTarget]]:
        """Located targets, grouped: each board by itself, tags of one family and size together."""
        kinds: dict[PlanarTarget, list[LocatedTarget]] = {}
        for one in self.located:
            target = one.target
            kind = replace(target, id=0) if isinstance(target, AprilTag) else target
            kinds.setdefault(kind, []).append(one)
        return list(kinds.values())

    def spacings(self) -> dict[str, EdgeSpacing]:
        """Distances between neighbouring corners over all pairs, by target."""
        return {
            str(target): measure_spacing(
                target, [one.fix.point for one in self.located if one.target == target]
            )
            for target in dict.fromkeys(one.target for one in self.located)
        }

    def rows(self) -> list[dict[str, Any]]:
        """One row per located target and pair, plain values."""
        return [one.document() for one in self.located]

    def summary(self) -> dict[str, Any]:
        """Everything as plain values."""
        return {
            "head": self.head.name,
            "head_digest": self.head.digest,
            "pairs": list(self.pairs),
            "joints_rad": {
                pair: dict(zip(self.head.joints, q.tolist(), strict=True))
                for pair, q in self.angles.items()
            }
            if eyes_move(self.head)
            else None,
            "located": self.rows(),
            "spacing_mm": {name: each.document() for name, each in self.spacings().items()},
            "missed": [
                {"pair": pair, "target": str(target), "why": why}
                for pair, target, why in self.missed
            ],
            "without_partner": [str(path) for path in self.unpaired],
            "not_read": list(self.failures),
        }

    def notes(self) -> list[str]:
        """Remarks for the user in addition to the table, one line each."""
        said = list(self.remarks)
        if self.unpaired:
            said.append(
                f"{len(self.unpaired)} of the images have no partner: "
                f"{join_first_names(path.name for path in self.unpaired)}"
            )
        for key, group in groupby(
            sorted(self.missed, key=lambda one: (str(one.target), one.seen_in)),
            key=lambda one: (str(one.target), one.seen_in),
        ):
            name, why = key
            names = [one.pair for one in group]
            where = "more than once in an image" if why == "twice" else f"in the {why} image only"
            pairs = "pair" if len(names) == 1 else "pairs"
            said.append(f"{name} found {where} of {len(names)} {pairs}: {join_first_names(names)}")
        return said + self._doubts()

    def _doubts(self) -> list[str]:
        """Signs that the head file and the images do not belong together, one line each."""
        said = []
        crossed = [one for one in self.located if one.valid.any()]
        lost = [one.pair for one in self.located if not one.valid.any()]
        if lost:
            said.append(
                f"the lines of sight do not cross before the eyes in "
                f"{join_first_names(dict.fromkeys(lost))} (are left and right swapped?)"
            )
        # coarse encoders separate the lines of sight by as much as their error turns an eye
        blur_rad = float(np.max(np.asarray(Noise.of(self.head).joint_rad)[EYES]))
        most = max(MAX_GAP_PX, 4.0 * blur_rad * float(self.head.cameras.focal.max()))
        apart = [one for one in crossed if one.gap_px > most]
        if apart:
            worst = max(apart, key=lambda one: one.gap_px)
            said.append(
                f"lines of sight miss each other by more than {most:.2g} px in {len(apart)} of "
                f"{len(crossed)} places, by {worst.gap_px:.1f} px in {worst.pair}: expected a head "
                "file of these cameras as they stand, and joint angles of that moment"
            )
        for every in self.located_by_target():
            edges = [one.mean_edge for one in every if one.spacing.edge_count]
            names = list(dict.fromkeys(str(one.target) for one in edges))
            said.append(describe_wrong_edges(join_first_names(names), edges))
        return [text for text in said if text]


def locate(config: LocateConfig, progress: Callable[[float], None] | None = None) -> LocateResult:
    """Find targets in pairs of photographs and triangulate them."""
    targets = parse_targets(config.target)
    response = None if config.response is None else parse_response(config.response)
    head = load_head(config.head)
    pairs, unpaired, single = pair_up(config.left, config.right)
    angles = read_joint_angles(head, config.joints, [pair.name for pair in pairs])
    finders = [
        TargetFinder(targets, Camera.of(head, eye), response) for eye in range(len(EYE_NAMES))
    ]
    read: list[str] = []
    located: list[LocatedTarget] = []
    missed: list[MissedTarget] = []
    failures: list[str] = []
    unseen = PhotographNotes(targets)
    shown: ShownPair | None = None
    rank = -1
    for number, pair in enumerate(pairs, 1):
        try:
            left, right = (
                finder.find_in_file(path) for finder, path in zip(finders, pair, strict=True)
            )
        except VergenceError as error:
            if single:
                raise
            failures.append(str(error))
            continue
        read.append(pair.name)
        for photograph in (left, right):
            unseen.add(photograph)
        here, not_here = _match(
            head, angles[pair.name], pair.name, left.detections, right.detections
        )
        located += here
        missed += not_here
        worth = 2 * bool(here) + bool(left.detections or right.detections)
        if worth > rank:
            shown, rank = ShownPair(left, right), worth
        if progress is not None:
            progress(number / len(pairs))
    if shown is None:
        raise ConfigurationError(
            f"expected images that can be read, got none in {len(pairs)} pairs; the first: "
            f"{failures[0]}"
        )
    return LocateResult(
        config=config,
        head=head,
        angles={name: angles[name] for name in read},
        pairs=tuple(read),
        located=tuple(located),
        missed=tuple(missed),
        remarks=(
            *unseen.notes(),
            *dict.fromkeys(line for finder in finders for line in finder.response_check.notes()),
            *remark_on_orientation_tags(path for pair in pairs for path in pair),
        ),
        unpaired=tuple(unpaired),
        failures=tuple(failures),
        shown=shown,
    )


def _match(
    head: HeadModel,
    q: FloatArray,
    pair: str,
    left: Sequence[Detection],
    right: Sequence[Detection],
) -> tuple[list[LocatedTarget], list[MissedTarget]]:
    """Triangulate the targets that both images have exactly once; list the others as missed."""
    located, missed = [], []
    for key, target in {target_key(d.target): d.target for d in (*left, *right)}.items():
        of_left, of_right = (
            [d for d in side if target_key(d.target) == key] for side in (left, right)
        )
        if len(of_left) == len(of_right) == 1:
            located.append(locate_target(head, q, pair, of_left[0], of_right[0]))
        elif of_left and of_right:
            missed.append(MissedTarget(pair, target, "twice"))
        else:
            missed.append(MissedTarget(pair, target, "left" if of_left else "right"))
    return located, missed
