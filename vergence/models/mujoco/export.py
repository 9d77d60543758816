"""Export of the head model to MJCF and URDF files."""

import re
import xml.etree.ElementTree as ET
from typing import Any

from vergence.errors import UnknownNameError
from vergence.models.head import HeadModel
from vergence.models.mujoco import scene as mujoco_scene
from vergence.models.mujoco.library import mujoco
from vergence.models.mujoco.model import build_spec, head_spec
from vergence.models.mujoco.urdf import to_urdf

FORMATS = ("mjcf", "urdf")
"""Formats of `export_files`."""

_SCENE = "scene"


def to_mjcf(head: HeadModel, **options: Any) -> str:
    """Write one head and its surroundings as a single MJCF text.

    MuJoCo writes numbers with six significant digits; the compiled model of `compile_model`
    is exact. The XML refers to texture files; `export_files` returns them.

    Args:
        head: one head, not a population.
        **options: see `build_spec`.

    Returns:
        The XML text.

    Raises:
        ConfigurationError: see `build_spec`.
    """
    return _xml(build_spec(head, **options))


def export_files(head: HeadModel, format: str) -> dict[str, bytes]:
    """Make the files of a head in one format, to be written into a folder.

    Args:
        head: one head, not a population.
        format: `mjcf` for `NAME.xml` (the head alone), `scene.xml` (which includes it and adds
            light, floor, a target and the fixed pair) and the target's texture, or `urdf` for
            `NAME.urdf`. NAME is the name of the head, see `file_stem`.

    Returns:
        File names, relative to the folder, with their contents.

    Raises:
        UnknownNameError: there is no such format.
        ConfigurationError: the head is a population, or has no lag (MJCF).
    """
    stem = file_stem(head)
    if format == "urdf":
        return {f"{stem}.urdf": to_urdf(head).encode()}
    if format != "mjcf":
        raise UnknownNameError("export format", format, list(FORMATS))
    scene = mujoco.MjSpec()
    scene.modelname = f"{head.name} scene"
    buffer = scene.visual.global_
    buffer.offwidth, buffer.offheight = head.cameras.size.max(axis=0).tolist()
    around = mujoco_scene.surroundings_of(head)
    mujoco_scene.add_scenery(scene, around)
    mujoco_scene.add_target(scene, "tag", surroundings=around)
    mujoco_scene.add_observer_cameras(scene, around)
    root = ET.fromstring(_xml(scene))
    root.insert(0, ET.Element("include", file=f"{stem}.xml"))
    # the head's file sets these elements for both files
    for element in [*root.findall("compiler"), *root.findall("option")]:
        root.remove(element)
    ET.indent(root)
    files = {
        f"{stem}.xml": _xml(head_spec(head, gravity=True)).encode(),
        f"{_SCENE}.xml": (ET.tostring(root, encoding="unicode") + "\n").encode(),
    }
    return files | {name: bytes(data) for name, data in scene.assets.items()}


def file_stem(head: HeadModel) -> str:
    """A head's name for files: letters, digits, `.`, `_` and `-`, and never `scene`."""
    stem = re.sub(r"[^A-Za-z0-9._-]+", "-", head.name).strip(".-") or "head"
    return f"{stem}-head" if stem.lower() == _SCENE else stem


def _xml(spec: mujoco.MjSpec) -> str:
    spec.compile()
    return str(spec.to_xml())
