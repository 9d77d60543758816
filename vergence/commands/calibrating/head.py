"""`vergence calibrate head`: joints, eyes and cameras of a head, from images of a board."""

import json
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from vergence.commands.console import print_read_errors, print_to_stderr, progress_bar
from vergence.commands.options import (
    Flat,
    JobOptions,
    check_writable,
    claimed_run_folder,
    dated_run_folder,
    print_written,
)
from vergence.commands.tables import print_table
from vergence.errors import ConfigurationError

if TYPE_CHECKING:
    from vergence.calibration.head.report import HeadJob, HeadOutcome
    from vergence.commands.options import RunFolder
    from vergence.models.head import HeadModel


@dataclass(frozen=True, kw_only=True)
class CalibrateHead:
    """Calibrate a head's joints, eyes and cameras from recordings of a board; write a head file.

    A recording is a folder made by vergence collect, a robot's log, or a folder with the images
    of both eyes in left and right and their joint angles in joints.csv. Several recordings are
    calibrated as separate heads; --out is then a folder for their files.
    """

    recordings: Annotated[
        tuple[Path, ...],
        tyro.conf.Positional,
        tyro.conf.arg(help_behavior_hint="", metavar="RECORDING..."),
    ] = ()
    """Recordings of a stationary board while the head moves."""
    head: Annotated[str, tyro.conf.arg(metavar="HEAD")]
    """Nominal head to start from: a preset's name or the path of a TOML file."""
    out: Annotated[Path, tyro.conf.arg(metavar="PATH")] = Path("calibrated.toml")
    """Head file to write; for several recordings a folder."""
    target: Annotated[
        str | None,
        tyro.conf.arg(aliases=["--board"], help_behavior_hint="", metavar="TARGET"),
    ] = None
    """The board, if the recording does not name it, such as checkerboard:9x6:24 or
    tag:36h11:0:120; lengths in mm."""
    hold_cameras: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """Hold focal lengths, principal points and lens coefficients at the values of the head file."""
    terms: Annotated[str, tyro.conf.arg(metavar="TERMS")] = "auto"
    """Optional terms of the model: none, some of play,harmonics,axes (backlash, harmonics of the
    encoders, directions of the axes), or auto: those that predict held-out poses significantly
    better."""
    name: Annotated[str, tyro.conf.arg(metavar="NAME")] = ""
    """Name of the calibrated head; by default the name of its file."""
    report: Annotated[Path | None, tyro.conf.arg(help_behavior_hint="", metavar="PATH")] = None
    """Run folder with the report, new or empty; runs/calibrate-head-DATE-TIME by default."""
    force: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """Replace existing result files."""
    json: bool = False
    """Print the result as JSON, and nothing else, on standard output."""
    machines: Flat[JobOptions] = field(default_factory=JobOptions)

    def run(self) -> int:
        """Run the command."""
        if not self.recordings:
            raise ConfigurationError("expected a recording, got none: vergence collect makes one")
        outs = self._outs()
        self._check(outs)
        from vergence.files import write_atomic

        with claimed_run_folder(self.report or dated_run_folder("calibrate-head")) as run:
            jobs = self._jobs(outs)
            outcomes = self._run(jobs)
            if len(jobs) == 1 and outcomes[0].refusal:
                raise ConfigurationError(f"{self.recordings[0]}: {outcomes[0].refusal}")
            run.save(lambda folder: _save(folder, outs, outcomes))
            self._check(outs)  # another process may have written them meanwhile
            for out, outcome in zip(outs, outcomes, strict=True):
                if outcome.head_file:
                    out.parent.mkdir(parents=True, exist_ok=True)
                    write_atomic(out, outcome.head_file)
            self._show(outs, outcomes, run)
        refused = [one for one in outcomes if one.refusal or one.document["not_read"]]
        return 0 if run.saved and not refused else 2

    def _outs(self) -> list[Path]:
        """Head files to write, one per recording."""
        if len(self.recordings) == 1:
            if self.out.suffix.lower() != ".toml":
                raise ConfigurationError(f"out: expected a name that ends in .toml, got {self.out}")
            return [self.out]
        names = [path.resolve().stem for path in self.recordings]
        twice = next((name for name in names if names.count(name) > 1), None)
        if twice is not None:
            raise ConfigurationError(
                f"expected recordings of different names, which their head files get, got {twice} "
                "twice"
            )
        if self.out.suffix or self.out.is_file():
            raise ConfigurationError(
                f"out: expected a folder for the head files of several recordings, got {self.out}"
            )
        return [self.out / f"{name}.toml" for name in names]

    def _check(self, outs: list[Path]) -> None:
        for out in outs:
            check_writable(out)
            if out.exists() and not self.force:
                raise ConfigurationError(
                    f"out: expected no file of that name (--force replaces it), got {out}"
                )

    def _jobs(self, outs: list[Path]) -> "list[HeadJob]":
        """Read the recordings."""
        from vergence.calibration.head.recording import read_recording
        from vergence.calibration.head.report import HeadJob
        from vergence.calibration.head.terms import parse_terms
        from vergence.calibration.observations import parse_board
        from vergence.models.head_file import check_head_name, load_head

        head: HeadModel = load_head(self.head)
        target = (
            parse_board(self.target, accept_single_tag=True) if self.target is not None else None
        )
        terms = parse_terms(self.terms)
        jobs = []
        with progress_bar("read") as report:
            for number, (path, out) in enumerate(zip(self.recordings, outs, strict=True)):
                name = self.name if self.name and len(outs) == 1 else out.stem
                check_head_name(name)
                recorded = read_recording(
                    path,
                    head,
                    target,
                    partial(_part, report, number, len(outs)),
                )
                jobs.append(
                    HeadJob(
                        head=head,
                        recording=recorded,
                        estimate_cameras=not self.hold_cameras,
                        terms=terms,
                        name=name,
                        head_file_name=out.name,
                        recording_path=str(path),
                    )
                )
                report((number + 1) / len(outs))
        return jobs

    def _run(self, jobs: "list[HeadJob]") -> "list[HeadOutcome]":
        with progress_bar("calibrate") as report:
            if len(jobs) == 1 and self.machines.cluster is None:
                return [jobs[0](report)]
            with self.machines.open_mapper(lambda done, total: report(done / total)) as mapper:
                return mapper(jobs)

    def _show(self, outs: list[Path], outcomes: "list[HeadOutcome]", run: "RunFolder") -> None:
        if self.json:
            documents = [
                {"refused": one.refusal} if one.refusal else dict(one.document) for one in outcomes
            ]
            print(json.dumps(documents[0] if len(outs) == 1 else documents, indent=2))
        elif len(outs) == 1:
            print_head_calibration(outcomes[0], outs[0])
        else:
            print_head_calibrations(outcomes, outs)
        if run.saved and not self.json:
            print_written(run.folder)
        for out, outcome in zip(outs, outcomes, strict=True):
            before = f"{out.stem}: " if len(outs) > 1 else ""
            if outcome.refusal:
                print_to_stderr(f"{before}{outcome.refusal}")
                continue
            for remark in outcome.document["remarks"]:
                print_to_stderr(f"{before}{remark}")
            print_read_errors(outcome.document["not_read"])


def _part(report: Callable[[float], None], number: int, count: int, done: float) -> None:
    """Report progress over all recordings from the progress of one."""
    report((number + done) / count)


def _save(folder: Path, outs: list[Path], outcomes: "list[HeadOutcome]") -> None:
    """Write the run folder; several recordings have a subfolder each."""
    for out, outcome in zip(outs, outcomes, strict=True):
        own = folder if len(outs) == 1 else folder / out.stem
        own.mkdir(exist_ok=True)
        for name, content in outcome.files.items():
            (own / name).write_bytes(content)
        if outcome.refusal:
            (own / "refused.txt").write_text(outcome.refusal + "\n", encoding="utf-8")


def print_head_calibration(outcome: "HeadOutcome", out: Path) -> None:
    """Print a head's calibration and the path of its file."""
    told = outcome.document
    rows = [
        [
            f"{each['distance_m']:g} m",
            *(_fixed(each[key]) for key in ("before_mm", "after_sigma_mm", "floor_mm")),
        ]
        for each in told["depth"]
    ]
    print_table(
        ["distance", "file is off by (mm)", "sigma now (mm)", "one fixation's sigma (mm)"],
        rows, title="depth straight ahead", wrapped=(0,),
    )  # fmt: skip
    print(
        f"{told['views']} of {told['views'] + told['left_out']} views in {told['poses']} poses, "
        f"{told['placements']} placement{'s' if told['placements'] > 1 else ''} of the board; "
        f"{told['rms_px']:.3f} px (length, rms) are left, {told['noise']:.2f} times what the "
        "detector says\n"
    )
    if told["unseen"]:
        print_table(
            ["not determined by this recording", "cure", "cost"],
            [[one["what"], one["cure"] or "none needed", one["cost"]] for one in told["unseen"]],
            wrapped=(0, 1, 2), shortenable=(0, 1, 2),
        )  # fmt: skip
    print(out)


def print_head_calibrations(outcomes: "list[HeadOutcome]", outs: list[Path]) -> None:
    """Print a line for each of several heads."""
    rows = []
    for outcome, out in zip(outcomes, outs, strict=True):
        if outcome.refusal:
            rows.append([str(out), "refused", "", "", ""])
            continue
        told = outcome.document
        last = told["depth"][-1]
        views = f"{told['views']} of {told['views'] + told['left_out']}"
        rows.append(
            [str(out), views, f"{told['rms_px']:.3f}", _fixed(last["before_mm"]),
             _fixed(last["after_sigma_mm"])]
        )  # fmt: skip
    far = next(
        (f"{one.document['depth'][-1]['distance_m']:g} m" for one in outcomes if one.document), ""
    )
    print_table(
        ["head", "views", "rms (px)", f"file off at {far} (mm)", "sigma now (mm)"],
        rows, wrapped=(0, 1), shortenable=(0,),
    )  # fmt: skip


def _fixed(value: float | None) -> str:
    return "" if value is None else f"{value:.3g}"
