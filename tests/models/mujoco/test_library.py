"""MuJoCo is imported in one place, and a missing or damaged one is told with its cure."""

import importlib
import importlib.metadata
import re
import subprocess
import sys
from pathlib import Path
from unittest.mock import Mock

import pytest

import vergence
from tests.naming import named
from vergence.errors import MujocoUnavailableError

WITHOUT = """
import sys
sys.modules["mujoco"] = None
import gymnasium, numpy as np, vergence
from vergence.cli import main
env = gymnasium.make("vergence/Gaze-v0", plant="kinematic")
env.reset(seed=1)
env.step(np.zeros_like(env.action_space.sample()))
head = vergence.load_head("simulated")
point = [0.1, 0.0, 1.0]
assert np.allclose(vergence.triangulate_gaze(head, head.fixate(point)).point, point)
sys.exit(main(["export", "mjcf", "--head", "icub", "--out", sys.argv[1]]))
"""


def test_a_mujoco_that_cannot_be_imported_is_told_with_its_cure(monkeypatch):
    for installed, cure in [
        ("3.3.0", "got 3.3.0; cure: pip install 'mujoco>=4,<5'"),
        ("4.0.0", "cure: pip install --force-reinstall --no-deps mujoco==4.0.0 mujoco-core==4.0.0"),
        (None, "got none; cure: pip install"),
    ]:
        with named(installed, cure):
            version = Mock(return_value=installed)
            if installed is None:
                version.side_effect = importlib.metadata.PackageNotFoundError("mujoco")
            monkeypatch.setitem(sys.modules, "mujoco", None)
            monkeypatch.delitem(sys.modules, "vergence.models.mujoco", raising=False)
            monkeypatch.setattr(importlib.metadata, "version", version)
            with pytest.raises(MujocoUnavailableError, match=re.escape(cure)):
                importlib.import_module("vergence.models.mujoco")


def test_it_is_imported_in_one_place():
    package = Path(vergence.__file__).parent
    pattern = re.compile(r"^\s*(import|from) mujoco\b", re.MULTILINE)
    importing = [path for path in package.rglob("*.py") if pattern.search(path.read_text("utf-8"))]
    assert importing == [package / "models" / "mujoco" / "__init__.py"]


@pytest.mark.nightly
def test_what_needs_no_mujoco_works_without_it(tmp_path):
    words = [sys.executable, "-c", WITHOUT, str(tmp_path / "out")]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.splitlines() == [
        "vergence: error: mujoco: expected MuJoCo 4, got 4.0.0 with files that are missing or "
        "damaged; cure: pip install --force-reinstall --no-deps mujoco==4.0.0 mujoco-core==4.0.0 "
        "mujoco-studio==4.0.0"
    ]
