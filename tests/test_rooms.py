"""`make check` runs the tests of what changed and those that name it, and no others."""

import subprocess

import pytest

from tests import rooms
from tests.naming import named


def git(house, *words):
    subprocess.run(["git", *words], cwd=house, check=True)


def commit(house):
    git(house, "add", ".")
    who = ("-c", "user.name=a", "-c", "user.email=a@b.c")
    git(house, *who, "commit", "-qm", "change", "--allow-empty")


@pytest.fixture
def house(tmp_path):
    """A package of three rooms, tests of four, and a page; all of it on `main`."""
    sources = {
        "vergence/models/__init__.py": "from .head import Head",
        "vergence/commands/run.py": 'RUN = "vergence.eval.run:run"',
        "tests/heads.py": "try:\n    import vergence.models.lens\nfinally:\n    pass",
        "tests/vision/test_tag.py": "def late():\n    from vergence.models import Head",
        "tests/eval/test_run.py": "from tests.heads import tied",
        "tests/test_cli.py": "from vergence.cli import main",
        "tests/test_docs.py": "import vergence",
    }
    empty = ("__init__", "cli", "models/head", "models/lens", "vision/tag", "eval/run")
    sources |= dict.fromkeys((f"vergence/{name}.py" for name in empty), "")
    empty = ("conftest", "test_architecture", "models/test_head")
    sources |= dict.fromkeys((f"tests/{name}.py" for name in empty), "")
    sources |= {"benchmarks/__init__.py": "", "docs/vision.md": ""}
    for name, text in sources.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    git(tmp_path, "init", "-q", "-b", "main")
    commit(tmp_path)
    return tmp_path


def places(house, capsys, *words):
    assert rooms.main(list(words), house) == 0
    return capsys.readouterr().out.split()


ALWAYS = "tests/test_architecture.py"
EVAL = [ALWAYS, "tests/eval", "tests/test_cli.py"]
"""Its own tests, and those of the commands."""
HEAD = [ALWAYS, "tests/models", "tests/vision/test_tag.py"]
"""Its own tests, and those that take it from its folder."""


def test_a_room_is_tested_by_all_that_name_it(house, capsys):
    for room, expected in (
        ("eval", EVAL),
        ("vision", [ALWAYS, "tests/vision"]),
        ("models", HEAD),
        ("heads", [ALWAYS, "tests/eval/test_run.py"]),
    ):
        with named(room, expected):
            assert places(house, capsys, room) == expected


def test_what_differs_from_main_is_tested(house, capsys):
    for changed, expected in (
        ("", [ALWAYS]),
        ("vergence/eval/run.py", EVAL),
        ("vergence/eval/section.jinja vergence/eval/größe.txt", EVAL),
        ("vergence/models/lens.py", HEAD[:2]),
        ("vergence/models/head.py", HEAD),
        ("vergence/__init__.py", [ALWAYS, "tests/test_docs.py"]),
        ("README.md LICENSE", [ALWAYS, "tests/test_docs.py"]),
        ("tests/vision/test_tag.py", [ALWAYS, "tests/vision"]),
        ("tests/conftest.py", ["tests"]),
        ("pyproject.toml", ["tests"]),
    ):
        with named(changed):
            git(house, "switch", "-qC", "work", "main")
            for name in changed.split():
                (house / name).write_text("pass\n")
            rooms.imports_of.cache_clear()
            assert places(house, capsys) == expected
            commit(house)
            assert places(house, capsys) == expected


def test_a_file_that_went_elsewhere_has_left_its_room_too(house, capsys):
    (house / "vergence/vision/tag.py").rename(house / "vergence/models/tag.py")
    git(house, "add", "-A")
    assert {"tests/models", "tests/vision"} <= set(places(house, capsys))


def test_where_nothing_differs_or_cannot_be_compared_or_named_that_is_said(house, capsys):
    assert rooms.main([], house) == 0
    assert "nothing differs from main" in capsys.readouterr().err
    git(house, "branch", "-qm", "trunk")
    assert rooms.main([], house) == 2
    assert "no room was named, expected a branch main" in capsys.readouterr().err
    assert rooms.main(["visio"], house) == 2
    assert "no room visio: expected some of architecture" in capsys.readouterr().err
