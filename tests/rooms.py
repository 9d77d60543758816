"""Which tests a change can break: those of the rooms it touches and of the rooms that import them.

`python -m tests.rooms` prints them for what differs from `main`, `python -m tests.rooms vision` for
one room. A room is a folder or a module right below the package, with its tests; a folder or a
module of tests alone is one too.
"""

import ast
import functools
import re
import subprocess
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path, PurePosixPath
from typing import Final, NamedTuple

ROOT: Final = Path(__file__).resolve().parents[1]
ALWAYS: Final = "architecture"
"""The room whose tests are quick and look at all others."""


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


def room_of(path: str) -> str | None:
    """The room of a file, given from the root with slashes; None for a file of no room.

    That of a test begins with `tests/`, so that a change in it is no change of what it tests.
    """
    parts = PurePosixPath(path).with_suffix("").parts
    if parts[0] in ("README", "docs"):
        return "docs"
    if parts[0] == "benchmarks":
        return "benchmarks"
    if parts[0] not in ("vergence", "tests"):
        return None
    name = [*parts, "__init__"][1].strip("_").removeprefix("test_")
    return name if parts[0] == "vergence" else f"tests/{name}"


def named_in(package: Path) -> Iterator[Import]:
    """What modules name as `"module:attribute"`, as registries do."""
    for module, path in sources_of(package).items():
        for name in re.findall(r'"([\w.]+):\w+"', path.read_text(encoding="utf-8")):
            yield Import(module, name)


def importers(root: Path = ROOT) -> dict[str, set[str]]:
    """The rooms that import or name each room; who imports the package has its public names."""
    found: dict[str, set[str]] = {}
    for package in ("vergence", "tests", "benchmarks"):
        for edge in (*imports_of(root / package), *named_in(root / package)):
            above, below = (room_of(f"{name.replace('.', '/')}.py") for name in edge)
            if above and below and above != below:
                found.setdefault(below, set()).add(above)
    for rooms in found.values():
        if "init" in rooms:
            rooms |= found.get("init", set())
    return found


def places_of(rooms: Iterable[str], root: Path = ROOT) -> list[str]:
    """The folders and files of tests of some rooms, from the root."""
    names = {room.removeprefix("tests/") for room in rooms}
    if "conftest" in names:
        return ["tests"]
    found = []
    for room in sorted(names):
        folder, files = root / "tests" / room, sorted((root / "tests").glob(f"test_{room}*.py"))
        found += [folder] if any(folder.rglob("test_*.py")) else []
        found += files
    return [path.relative_to(root).as_posix() for path in found]


def changed(root: Path = ROOT) -> set[str]:
    """The rooms of the files that differ from where this branch left `main`, new ones too."""

    def git(*words: str) -> list[str]:
        result = subprocess.run(
            ["git", *words], cwd=root, capture_output=True, text=True, check=True
        )
        return result.stdout.splitlines()

    try:
        (base,) = git("merge-base", "HEAD", "main")
    except subprocess.CalledProcessError as error:
        sys.exit(f"no place to compare with, name a room: {error.stderr.strip()}")
    paths = git("diff", "--name-only", base) + git("ls-files", "--others", "--exclude-standard")
    return {room for path in paths if (room := room_of(path))}


def main(words: list[str], root: Path = ROOT) -> int:
    """Print the tests of the named rooms, or of those that changed, and of what imports them."""
    above = importers(root)
    known = {room.removeprefix("tests/") for room in set(above).union(*above.values())}
    for word in words:
        if word not in known:
            print(f"no room {word}: expected {', '.join(sorted(known))}", file=sys.stderr)
            return 2
    rooms = {*words, *(f"tests/{word}" for word in words)} or changed(root)
    print(*places_of({ALWAYS}.union(rooms, *(above.get(room, set()) for room in rooms)), root))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
