"""Imports point one way, form no cycles, and `import vergence` stays light."""

import graphlib
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from tests.naming import named
from tests.rooms import imports_of, sources_of

PACKAGE = Path(__file__).resolve().parents[1] / "vergence"

# From the bottom up. A unit (a folder or a module right below the package) may import its own layer
# and those below it. `__init__` is the package itself, which gathers the public names.
LAYERS = (
    {"errors", "files", "interrupts", "entry_points", "operands", "kernels"},
    {"models"},
    {"vision", "triangulation"},
    {"envs", "perception", "reporting"},
    {"controllers"},
    {"recording"},
    {"hardware"},
    {"calibration", "training", "eval"},
    {"viewer"},
    {"__init__"},
    {"commands"},
    {"cli", "__main__"},
)  # fmt: skip
RANK = {unit: rank for rank, layer in enumerate(LAYERS) for unit in layer}

# Third parties that one unit alone may import, so that everything else runs on the base install.
RESERVED = {
    **dict.fromkeys(("torch", "stable_baselines3", "tensorboard"), "training"),
    **dict.fromkeys(("optuna", "sqlalchemy"), "eval"),
    "serial": "hardware",
    "mcap": "recording",
    "viser": "viewer",
}

# What somebody who only wants geometry, or a help text, should not wait for.
HEAVY = {
    "vergence": {"matplotlib", "pandas", "pyarrow", "pygame", "stable_baselines3", "torch"},
    "vergence.cli": {"gymnasium", "importlib.metadata", "numba", "numpy", "vergence.models"},
}


def unit_of(module: str) -> str:
    """The folder or module right below the package that a module belongs to."""
    return [*module.split("."), "__init__"][1]


def layer_violations(package: Path) -> list[str]:
    """Violations of the layer rule, one line each with both modules' names."""
    faults = [
        f"{module} belongs to no layer"
        for module in sources_of(package)
        if unit_of(module) not in RANK
    ]
    for edge in imports_of(package):
        root = edge.imported.split(".")[0]
        importer_unit = unit_of(edge.importer)
        if root == package.name:
            if RANK.get(unit_of(edge.imported), -1) > RANK.get(importer_unit, len(LAYERS)):
                faults.append(f"{edge}, which lies above it")
        elif importer_unit != RESERVED.get(root, importer_unit):
            faults.append(f"{edge}, which only {package.name}.{RESERVED[root]} may")
    return faults


def cycles(package: Path) -> list[str | None]:
    """A cycle of modules, and one of folders where no modules are in a circle: "a imports b"."""
    sources = sources_of(package)
    edges = [edge for edge in imports_of(package) if edge.imported in sources]
    found: list[str | None] = []
    for pairs in (edges, [tuple(map(unit_of, edge)) for edge in edges]):
        imports: dict[str, set[str]] = {}
        for importer, imported in pairs:
            imports.setdefault(importer, set()).update({imported} - {importer})
        try:
            graphlib.TopologicalSorter(imports).prepare()
            found.append(None)
        except graphlib.CycleError as error:
            found.append(" imports ".join(reversed(error.args[1])))
    return found


def test_imports_point_one_way_and_form_no_cycle():
    assert layer_violations(PACKAGE) == []
    assert cycles(PACKAGE) == [None, None]


def test_mujoco_is_imported_in_one_place():
    edges = (edge for edge in imports_of(PACKAGE) if edge.imported.split(".")[0] == "mujoco")
    assert {edge.importer for edge in edges} == {"vergence.models.mujoco"}


@pytest.mark.slow
def test_importing_vergence_or_its_command_line_stays_light():
    for module, heavy in HEAVY.items():
        code = f"import sys; sys.argv = ['vergence']; import {module}; print(*sys.modules)"
        done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
        with named(module):
            assert done.returncode == 0, done.stderr
            assert heavy & set(done.stdout.split()) == set()


# The rest shows that the checks above can fail, on packages that break one rule each.


def package_of(folder: Path, sources: dict[str, str]) -> Path:
    package = Path(tempfile.mkdtemp(dir=folder)) / "vergence"
    for name, source in {"__init__.py": "", **sources}.items():
        (package / name).parent.mkdir(parents=True, exist_ok=True)
        (package / name).write_text(source)
    return package


def test_a_fault_names_both_modules(tmp_path):
    for path, source, fault in (
        ("models/head.py", "from ..envs import task",
         "models.head imports vergence.envs, which lies above it"),
        ("models/__init__.py", "from ..envs.task import Gaze",
         "models imports vergence.envs.task, which lies above it"),
        ("vision/tag.py", "def late():\n    import vergence.eval.report",
         "vision.tag imports vergence.eval.report, which lies above it"),
        ("envs/task.py", "if TYPE_CHECKING:\n    from vergence.controllers.ibvs import Ibvs",
         "envs.task imports vergence.controllers.ibvs, which lies above it"),
        ("models/head.py", "from vergence import load_head",
         "models.head imports vergence, which lies above it"),
        ("models/head.py", "import torch.nn",
         "models.head imports torch.nn, which only vergence.training may"),
        ("gadgets/lamp.py", "", "gadgets.lamp belongs to no layer"),
    ):  # fmt: skip
        with named(path, source):
            assert layer_violations(package_of(tmp_path, {path: source})) == [f"vergence.{fault}"]


def test_a_cycle_of_modules_or_of_folders_is_reported_in_the_order_of_the_imports(tmp_path):
    cycle, _ = cycles(package_of(tmp_path, {
        "models/joints.py": "from . import limits",
        "models/limits.py": "def late():\n    from .head import Head",
        "models/head.py": "from vergence.models.joints import EYES",
    }))  # fmt: skip
    path = [name.removeprefix("vergence.models.") for name in cycle.split(" imports ")]
    assert "joints limits head joints limits" in " ".join(path + path[1:])
    modules, units = cycles(package_of(tmp_path, {
        "vision/tag.py": "from vergence.triangulation import noise",
        "triangulation/noise.py": "",
        "triangulation/rays.py": "from vergence.vision import pixels",
        "vision/pixels.py": "",
    }))  # fmt: skip
    assert modules is None
    assert sorted(units.split(" imports ")[:2]) == ["triangulation", "vision"]
