"""`vergence print-target`: what is printed has the stated size, measured on the page itself."""

import re
import time
import xml.etree.ElementTree as ET
from pathlib import Path

import cv2
import numpy as np
import pypdfium2
import pytest

from tests.commands.called import call, refused
from vergence.vision import make_detector, parse_target
from vergence.vision.printing import Paper, PrintSheet, lay_out_sheet, parse_paper

DPI = 254  # ten pixels to the millimetre: sheets are whole pixels
PX_MM = 0.1
BOARDS = [
    ("checkerboard:9x6:24", "a4", "pdf"),  # its ruler stands at the side
    ("charuco:5x7:31.7:23.1:5X5_100", "letter", "pdf"),  # a marker's bit is no part of a square
    ("charuco:5x7:31.7:23.1:5X5_100", "letter", "png"), ("aprilgrid:6x6:20:0.3", "a4", "png"),
    ("tag:36h11:5:120", "a4", "png"), ("tag:Standard41h12:7:35", "100x150", "pdf"),
]  # fmt: skip


def laid_out(text: str, paper: str) -> PrintSheet:
    return lay_out_sheet(parse_target(text), parse_paper(paper))


def printed(path: Path, text: str, paper: str, *words: str) -> np.ndarray:
    """The file that the command writes, as grey pixels at `DPI`."""
    assert call("print-target", text, "--paper", paper, "--out", path, *words) == 0
    if path.suffix == ".png":
        return cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    with pypdfium2.PdfDocument(path) as document:
        assert len(document) == 1
        # a little less: a sheet is stretched to the next whole pixel
        page = document[0].render(scale=(1.0 - 1e-6) * DPI / 72.0, grayscale=True)
        return page.to_numpy().copy()


def ruler_length_mm(image: np.ndarray, sheet: PrintSheet) -> float:
    """The distance of the end ticks' middles, along a line that the other ticks do not reach."""
    column, row = (round((place + 2.9) / PX_MM) for place in sheet.ruler_zero_mm)
    line = image[:, column] if sheet.ruler_upright else image[row]
    dark = 255.0 - line
    dark[dark < 40.0] = 0.0
    places = np.flatnonzero(dark)
    cut = places[np.argmax(np.diff(places))] + 1
    first, last = (
        np.average(np.arange(len(line))[part], weights=dark[part])
        for part in (slice(0, cut), slice(cut, None))
    )
    return (last - first) * PX_MM


@pytest.mark.nightly
@pytest.mark.parametrize(("text", "paper", "ending"), BOARDS)
def test_what_is_printed_measures_what_was_stated(text, paper, ending, tmp_path):
    words = ("--dpi", str(DPI)) if ending == "png" else ()
    image = printed(tmp_path / f"board.{ending}", text, paper, *words)
    target, sheet = parse_target(text), laid_out(text, paper)
    size = (sheet.width_mm / PX_MM, sheet.height_mm / PX_MM)
    assert image.shape[::-1] == pytest.approx(size)
    found = make_detector(target).detect(image)
    seen = found.corners_px * PX_MM
    true = 1000.0 * target.corners_m
    assert np.isfinite(seen).all()
    between = [np.hypot(*(each[:, None] - each).transpose(2, 0, 1)) for each in (seen, true)]
    np.testing.assert_allclose(*between, atol=0.01)
    # upright, as the viewer sees it
    np.testing.assert_allclose(seen - seen[0], true - true[0], atol=0.01)
    assert ruler_length_mm(image, sheet) == pytest.approx(100.0, abs=0.01)


def test_an_svg_has_the_size_of_the_paper_and_outlines_where_they_are_laid_out(tmp_path):
    text, paper = "tag:36h11:5:120", "a4"
    assert call("print-target", text, "--paper", paper, "--out", tmp_path / "tag.svg") == 0
    root, sheet = ET.parse(tmp_path / "tag.svg").getroot(), laid_out(text, paper)
    size_mm = [
        float(root.get(side).removesuffix("pt")) * 25.4 / 72.0 for side in ("width", "height")
    ]
    assert size_mm == pytest.approx([sheet.width_mm, sheet.height_mm], abs=0.01)
    unit_mm = size_mm[0] / float(root.get("viewBox").split()[2])
    (drawn,) = root.iterfind(".//*[@id='patch_2']/{*}path")
    points = unit_mm * np.array(re.findall(r"([-\d.]+) ([-\d.]+)", drawn.get("d")), float)
    expected = np.vstack(sheet.black_outlines_mm)
    for end in (np.min, np.max):
        np.testing.assert_allclose(end(points, axis=0), end(expected, axis=0), atol=0.01)


@pytest.mark.slow
def test_the_margin_is_white_and_nothing_leaves_the_printable_area(tmp_path):
    for text, paper, margin_mm in [
        ("tag:Standard41h12:7:35", "100x150", 7.0), ("charuco:5x3:36:27:4X4_50", "a5", 9.0),
    ]:  # fmt: skip
        image = printed(tmp_path / "board.pdf", text, paper, "--force")
        black = image < 250
        outside = black.copy()
        edge = int(4.8 / PX_MM)
        outside[edge:-edge, edge:-edge] = False
        assert not outside.any(), text
        outline = np.vstack(laid_out(text, paper).black_outlines_mm)
        left, top = np.floor((outline.min(axis=0) - 0.05) / PX_MM).astype(int)
        right, bottom = np.ceil((outline.max(axis=0) + 0.05) / PX_MM).astype(int)
        black[top:bottom, left:right] = False
        assert black.any(), text  # the ruler
        wide = int((margin_mm - 0.2) / PX_MM)
        around = black[max(0, top - wide) : bottom + wide, max(0, left - wide) : right + wide]
        assert min(top, left) * PX_MM > margin_mm - 0.2
        assert not around.any(), text


@pytest.mark.slow
def test_a_print_has_its_text_and_the_same_bytes_later(tmp_path, monkeypatch):
    text = "charuco:4x3:30:22:4X4_50"
    files = [tmp_path / f"a.{ending}" for ending in ("pdf", "svg", "png")]
    contents = []
    for later_s in (0.0, 1e7):
        now = time.time() + later_s
        monkeypatch.setattr(time, "time", lambda now=now: now)
        for path in files:
            assert call("print-target", text, "--paper", "a5", "--out", path, "--overwrite") == 0
        contents.append([path.read_bytes() for path in files])
    assert contents[0] == contents[1]
    with pypdfium2.PdfDocument(files[0]) as document:
        assert document[0].get_textpage().get_text_range().split("\r\n") == [
            "print at 100 %, measure this: 100 mm", text,
        ]  # fmt: skip
    assert b"/PrintScaling /None" in contents[0][0]


def test_a_refusal_names_paper_and_size_that_work(capsys, tmp_path):
    for text, paper in (("checkerboard:9x6:40", "a4"), ("tag:36h11:5:300", "200x150")):
        line = refused(capsys, "print-target", text, "--paper", paper, "--out", tmp_path / "a.pdf")
        said = r"fits on .* got (\S+) that needs .* --paper (\S+), or .* (\S+) mm$"
        found = re.search(said, line)
        assert found is not None, line
        assert found[1] == text
        laid_out(text, found[2])
        laid_out(f"{text.rpartition(':')[0]}:{found[3]}", paper)
    assert list(tmp_path.iterdir()) == []


def test_what_cannot_be_printed_is_refused_in_one_line(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("there.pdf").write_text("mine")
    board = "checkerboard:9x6:20"
    for words, said in [
        (["checkerboard:9x6"], "expected its size in mm at the end, such as checkerboard:9x6:20"),
        (["tag:36h11"], "expected one tag with its number and its edge in mm"),
        ([board, "--paper", "a6"], "'a6'"),
        ([board, "--paper", "0x100"], "expected edges of up to 5000 mm, got 0x100"),
        ([board, "--paper", "90x90"], "the ruler: give --paper a4"),
        ([board, "--out", "a.jpg"], "ends in .pdf, .svg or .png, got a.jpg"),
        ([board, "--out", "there.pdf"], "(--force replaces it), got there.pdf"),
        ([board, "--out", "there.pdf/a.pdf"], "out: expected a folder that can be written"),
        ([board, "--dpi", "300"], "dpi: expected none for a .pdf, got 300"),
        ([board, "--out", "a.png", "--dpi", "1e5"], "dpi: expected 50 to"),
    ]:
        assert said in refused(capsys, "print-target", *words)
    assert [path.name for path in tmp_path.iterdir()] == ["there.pdf"]
    assert Path("there.pdf").read_text() == "mine"


def test_sizes_without_a_name_may_be_given_either_way_round():
    assert parse_paper("150x100") == parse_paper("100X150") == Paper(100.0, 150.0)
    assert parse_paper("A4").long_mm == 297.0
