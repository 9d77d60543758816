"""Read and write the cameras as TOML: image size, intrinsics, lens, response, mounting pose."""

from typing import Any

import numpy as np

from vergence.errors import ConfigurationError, HeadFileError
from vergence.models.cameras import BROWN_CONRADY, LENSES, PINHOLE, Cameras
from vergence.models.files.head_rules import DISTORTION, FOCAL, METRES, PIXELS, SIZE
from vergence.models.files.joints_toml import parse_pose, parse_rotation
from vergence.models.files.toml_table import Table
from vergence.models.joints import EYE_NAMES
from vergence.models.parts import FloatArray
from vergence.models.response import EXPECTED, CameraResponse, parse_response


def parse_eyes(root: Table) -> tuple[Cameras, FloatArray]:
    """Cameras of a head file, and (2, 4, 4) the pose of each in its eye's last link."""
    image = _parse_size(root.table("image"), closing=True) if root.has("image") else None
    size, lens, focal, principal, distortion = [], [], [], [], np.zeros((2, 8))
    response: list[CameraResponse | None] = []
    head_eye = np.zeros((2, 4, 4))
    for eye, table in enumerate(root.tables("eyes", 2)):
        table.require_equal("name", EYE_NAMES[eye], "the left eye comes first, then the right one")
        width, height = _parse_eye_size(table, image)
        size.append((width, height))
        focal.append(table.numbers("focal_px", (2,), FOCAL))
        centre = table.numbers("principal_px", (2,), PIXELS)
        if not (0.0 < centre[0] < width and 0.0 < centre[1] < height):
            raise HeadFileError(
                table.key("principal_px"),
                centre.tolist(),
                f"a point inside the image of {width} x {height} px",
            )
        principal.append(centre)
        model, coefficients = _parse_lens(table)
        lens.append(model)
        distortion[eye, : len(coefficients)] = coefficients
        response.append(_parse_response(table))
        head_eye[eye] = _parse_mount(table)
        table.close()
    cameras = Cameras(
        size=np.array(size),
        focal=np.array(focal),
        principal=np.array(principal),
        distortion=distortion,
        lens=(lens[0], lens[1]),
        response=(response[0], response[1]),
    )
    return cameras, head_eye


def _parse_size(table: Table, *, closing: bool = False) -> tuple[int, int]:
    size = table.integer("width_px", SIZE), table.integer("height_px", SIZE)
    if closing:
        table.close()
    return size


def _parse_eye_size(table: Table, image: tuple[int, int] | None) -> tuple[int, int]:
    if image is None:
        return _parse_size(table)
    for key in ("width_px", "height_px"):
        if table.has(key):
            raise HeadFileError(
                table.key(key),
                table.take(key, ""),
                "no size of the eye's own beside [image], which holds for both eyes",
            )
    return image


def _parse_lens(table: Table) -> tuple[str, FloatArray]:
    """Lens model of a camera and its coefficients; a pinhole becomes Brown-Conrady with zeros."""
    said = table.has("lens")
    lens = table.choice("lens", [PINHOLE, *LENSES]) if said else BROWN_CONRADY
    if not said and table.has("distortion"):
        _refuse_unnamed(table)
    if lens != PINHOLE:
        return lens, table.numbers("distortion", (len(LENSES[lens]),), DISTORTION[lens])
    if table.has("distortion"):
        given = table.take("distortion", "")
        if not isinstance(given, list) or any(value != 0 for value in given):
            raise HeadFileError(
                table.key("distortion"), given, f"zeros, or no such key, for lens = '{PINHOLE}'"
            )
    return BROWN_CONRADY, np.zeros(len(LENSES[BROWN_CONRADY]))


def _refuse_unnamed(table: Table) -> None:
    """Refuse coefficients without a lens name if their count fits a non-default model."""
    given = table.peek("distortion")
    for lens, coefficients in LENSES.items():
        if lens != BROWN_CONRADY and isinstance(given, list) and len(given) == len(coefficients):
            raise HeadFileError(
                table.key("distortion"),
                given,
                f"{len(LENSES[BROWN_CONRADY])} numbers, or lens = '{lens}' beside them",
            )


def _parse_response(table: Table) -> CameraResponse | None:
    if not table.has("response"):
        return None
    value = table.take("response", EXPECTED)
    try:
        return parse_response(value)
    except ConfigurationError as error:
        raise HeadFileError(table.key("response"), value, EXPECTED) from error


def _parse_mount(table: Table) -> FloatArray:
    """(4, 4) pose of a camera in its eye's last link."""
    if not table.has("head_eye_rotation"):
        return parse_pose(table, "position_m")
    mount = np.eye(4)
    mount[:3, :3] = parse_rotation(table, "head_eye_rotation")
    mount[:3, 3] = table.numbers("head_eye_translation_m", (3,), METRES)
    return mount


def eyes_to_toml(
    cameras: Cameras, head_eye: FloatArray, rotation_position_keys: tuple[str, str]
) -> dict[str, Any]:
    """Write the tables `eyes` and, for images of one size, `image`; (2, 4, 4) poses in metres."""
    sizes = [{"width_px": width, "height_px": height} for width, height in cameras.size.tolist()]
    one_size = sizes[0] == sizes[1]
    eyes = [
        {
            "name": name,
            **({} if one_size else sizes[eye]),
            "focal_px": cameras.focal[eye].tolist(),
            "principal_px": cameras.principal[eye].tolist(),
            **({} if lens == BROWN_CONRADY else {"lens": lens}),
            "distortion": cameras.distortion[eye, : len(LENSES[lens])].tolist(),
            **({} if cameras.response[eye] is None else {"response": cameras.response[eye]}),
            rotation_position_keys[0]: head_eye[eye, :3, :3].tolist(),
            rotation_position_keys[1]: head_eye[eye, :3, 3].tolist(),
        }
        for eye, (name, lens) in enumerate(zip(EYE_NAMES, cameras.lens, strict=True))
    ]
    return {**({"image": sizes[0]} if one_size else {}), "eyes": eyes}
