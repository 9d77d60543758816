"""List the tests that a change can break: those of changed rooms and of rooms that import them.

`python -m tests.rooms` prints them for the differences from `main`, `python -m tests.rooms vision`
for one room. A room is a folder or a module right below the package, with its tests; a folder or a
module of tests alone is one too.
"""

import ast
import functools
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path, PurePosixPath
from typing import Final, NamedTuple

from vergence.errors import ConfigurationError

ROOT: Final = Path(__file__).resolve().parents[1]
ALWAYS: Final = frozenset({"architecture", "words"})
"""Rooms whose tests are quick and look at all others."""
EVERYTHING: Final = "tests/conftest"
ELSEWHERE: Final = {
    "README": ("docs",),
    "CONTRIBUTING": ("docs",),
    "docs/": ("docs", "tests/controllers", "tests/eval", "tests/training"),
    "benchmarks/": ("benchmarks",),
    "models/": ("tests/models",),
    "tests/data/": ("tests/models", "tests/triangulation", "tests/eval"),
    **dict.fromkeys(("pyproject.toml", "constraints.txt"), (EVERYTHING,)),
}
"""The rooms of files that stand in none, by how their paths begin."""


class Import(NamedTuple):
    """One module importing another, both by their absolute names."""

    importer: str
    imported: str

    def __str__(self) -> str:
        return f"{self.importer} imports {self.imported}"


def sources_of(package: Path) -> dict[str, Path]:
    """Every module of a package by its absolute name."""
    sources = {}
    for path in sorted(package.rglob("*.py")):
        parts = path.relative_to(package.parent).with_suffix("").parts
        sources[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return sources


@functools.cache
def imports_of(package: Path) -> list[Import]:
    """Every import statement of a package, in functions and under TYPE_CHECKING too."""
    sources = sources_of(package)
    return [
        Import(module, imported)
        for module, path in sources.items()
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"), str(path)))
        for imported in _imported(node, module, path, sources)
    ]


def _imported(node: ast.AST, module: str, path: Path, sources: dict[str, Path]) -> Iterator[str]:
    if isinstance(node, ast.Import):
        yield from (alias.name for alias in node.names)
    elif isinstance(node, ast.ImportFrom):
        origin = node.module or ""
        if node.level:
            up = node.level - (path.name == "__init__.py")
            base = module.split(".")[: len(module.split(".")) - up]
            origin = ".".join([*base, *filter(None, [node.module])])
        for alias in node.names:
            submodule = f"{origin}.{alias.name}"
            yield submodule if submodule in sources else origin


def rooms_of(path: str) -> set[str]:
    """The rooms of a file, given from the root with slashes.

    That of a test begins with `tests/`, so that a change in it is no change of what it tests.
    """
    for place, rooms in ELSEWHERE.items():
        if path.startswith(place):
            return set(rooms)
    parts = PurePosixPath(path).with_suffix("").parts
    if parts[0] not in ("vergence", "tests"):
        return set()
    name = [*parts, "__init__"][1].strip("_").removeprefix("test_")
    return {name if parts[0] == "vergence" else f"tests/{name}"}


def named_in(package: Path) -> Iterator[Import]:
    """Imports by name, written as `"module:attribute"`, as in registries."""
    for module, path in sources_of(package).items():
        for name in re.findall(r'"([\w.]+):\w+"', path.read_text(encoding="utf-8")):
            yield Import(module, name)


def importers(root: Path = ROOT) -> dict[str, set[str]]:
    """The rooms that import or name each room; who imports the package has its public names."""
    found: dict[str, set[str]] = {}
    for package in ("vergence", "tests", "benchmarks"):
        for edge in (*imports_of(root / package), *named_in(root / package)):
            above, below = (rooms_of(f"{name.replace('.', '/')}.py") for name in edge)
            for room in below - above:
                found.setdefault(room, set()).update(above)
    for rooms in found.values():
        for through in ("init", "commands"):  # public names, and then commands as called
            rooms |= found.get(through, set()) if through in rooms else set()
    return found


def places_of(rooms: set[str], root: Path = ROOT) -> list[str]:
    """The folders and files of tests of some rooms, from the root."""
    if EVERYTHING in rooms:
        return ["tests"]
    found = []
    for room in sorted({room.removeprefix("tests/") for room in rooms}):
        folder, files = root / "tests" / room, (root / "tests").glob(f"test_{room}*.py")
        found += [folder] if any(folder.rglob("test_*.py")) else []
        found += sorted(files)
    return [path.relative_to(root).as_posix() for path in dict.fromkeys(found)]


def changed(root: Path = ROOT) -> set[str]:
    """The rooms of the files that differ from where this branch left `main`, new ones too.

    Raises:
        ConfigurationError: there is no git, no repository, or no `main`.
    """

    def git(*words: str) -> list[str]:
        command = ["git", "-c", "core.quotePath=false", *words]
        result = subprocess.run(command, cwd=root, capture_output=True, text=True, check=True)
        return result.stdout.splitlines()

    try:
        branches = git("for-each-ref", "--format=%(refname)")
        trunk = "main" if "refs/heads/main" in branches else "origin/main"
        (base,) = git("merge-base", "HEAD", trunk)
        paths = git("diff", "--no-renames", "--relative", "--name-only", base)
        paths += git("ls-files", "--others", "--exclude-standard")
    except (OSError, subprocess.CalledProcessError) as error:
        why = getattr(error, "stderr", None) or error
        raise ConfigurationError(f"expected a branch main to compare with, got: {why}") from error
    if not paths:
        print(f"nothing differs from {trunk}: name a room to test it", file=sys.stderr)
    return set().union(*map(rooms_of, paths))


def main(words: list[str], root: Path = ROOT) -> int:
    """Print the tests of the named rooms, or of those that changed, and of what imports them."""
    above = importers(root)
    known = {room.removeprefix("tests/") for room in set(above).union(*above.values())}
    known |= {path.stem.removeprefix("test_") for path in (root / "tests").glob("test_*.py")}
    names = [word.strip("_/") for word in words]
    for name in {*names} - known:
        rooms = ", ".join(room for room in sorted(known) if places_of({room}, root))
        print(f"no room {name}: expected some of {rooms}", file=sys.stderr)
        return 2
    try:
        rooms = {*names, *(f"tests/{name}" for name in names)} or changed(root)
    except ConfigurationError as error:
        print(f"no room was named, {error}".strip(), file=sys.stderr)
        return 2
    print(*places_of(ALWAYS.union(rooms, *(above.get(room, set()) for room in rooms)), root))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
