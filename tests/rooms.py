"""List the tests of what changed: those of its rooms, and all that name a changed module.

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
from importlib.util import resolve_name
from pathlib import Path, PurePosixPath
from typing import Final, NamedTuple

ROOT: Final = Path(__file__).resolve().parents[1]
PACKAGES: Final = ("vergence", "tests", "benchmarks")
ALWAYS: Final = frozenset({"architecture", "words"})
"""Rooms whose tests are quick and look at all others."""
EVERYTHING: Final = "conftest"
ELSEWHERE: Final = {
    "README": ("docs",),
    "CONTRIBUTING": ("docs",),
    "docs/": ("docs", "controllers", "eval", "training"),
    "benchmarks/": ("benchmarks",),
    "models/": ("models",),
    "tests/data/": ("models", "triangulation", "eval"),
    **dict.fromkeys(("pyproject.toml", "constraints.txt"), (EVERYTHING,)),
}
"""The rooms of files that stand in none, by how their paths begin."""


class Import(NamedTuple):
    importer: str
    imported: str

    def __str__(self) -> str:
        return f"{self.importer} imports {self.imported}"


def sources_of(package: Path) -> dict[str, Path]:
    """Every module of a package by its absolute name."""
    paths = sorted(package.rglob("*.py"))
    return {_module_at(PurePosixPath(path.relative_to(package.parent))): path for path in paths}


@functools.cache
def imports_of(package: Path) -> list[Import]:
    """Every import statement of a package, in functions and under TYPE_CHECKING too."""
    sources = sources_of(package)
    return [
        Import(module, imported)
        for module, path in sources.items()
        for imported in _imported(module, path, sources)
    ]


def _imported(module: str, path: Path, sources: dict[str, Path]) -> Iterator[str]:
    home = module if path.name == "__init__.py" else module.rpartition(".")[0]
    waiting: list[ast.AST] = [ast.parse(path.read_text(encoding="utf-8"), str(path))]
    while waiting:  # all statements; `ast.walk` takes three times as long, for expressions
        node = waiting.pop()
        for field in ("body", "orelse", "finalbody", "handlers", "cases"):
            inner = getattr(node, field, ())
            waiting += inner if isinstance(inner, list) else ()
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            origin = resolve_name("." * node.level + (node.module or ""), home)
            for alias in node.names:
                submodule = f"{origin}.{alias.name}"
                yield submodule if submodule in sources else origin


def rooms_of(path: str) -> set[str]:
    """The rooms of a file, given from the root with slashes."""
    for place, rooms in ELSEWHERE.items():
        if path.startswith(place):
            return set(rooms)
    parts = PurePosixPath(path).with_suffix("").parts
    if parts[0] not in ("vergence", "tests"):
        return set()
    return {[*parts, "__init__"][1].strip("_").removeprefix("test_")}


def named_by_tests(root: Path = ROOT) -> dict[str, set[str]]:
    """The modules that each file of tests names: itself, by a folder or by commands that it calls.

    What a helper of tests names does not count: nearly all tests make a head by one.
    """
    named: dict[str, set[str]] = {}
    for package in PACKAGES:
        for module, path in sources_of(root / package).items():  # by name, as in registries
            named[module] = {*re.findall(r'"([\w.]+):\w+"', path.read_text(encoding="utf-8"))}
        for importer, imported in imports_of(root / package):
            named[importer].add(imported)
    sources = sources_of(root / "vergence")
    folders = {name for name, path in sources.items() if path.stem == "__init__"}
    folders -= {"vergence"}  # many tests import it so that environments are registered
    called = {name for caller, found in named.items() if _calls({caller}) for name in found}
    tests = {}
    for path in (root / "tests").rglob("test_*.py"):
        place = PurePosixPath(path.relative_to(root))
        its: set[str] = set()
        waiting = {_module_at(place)}
        while waiting:
            new = named.get(waiting.pop(), set()) - its
            its |= new
            waiting |= new & folders
        tests[place.as_posix()] = its | called if _calls(its) else its
    return tests


def _calls(names: set[str]) -> bool:
    """True for who calls commands, and so names all that they name."""
    return any(f"{name}.".startswith(("vergence.cli.", "vergence.commands.")) for name in names)


def places_of(rooms: set[str], root: Path = ROOT) -> list[str]:
    """The folders and files of tests of some rooms, from the root."""
    tests, found = root / "tests", []
    for room in sorted(rooms):
        found += [tests / room] if any((tests / room).rglob("test_*.py")) else []
        found += sorted(tests.glob(f"test_{room}*.py"))
    return [path.relative_to(root).as_posix() for path in dict.fromkeys(found)]


def changed(root: Path = ROOT) -> set[str]:
    """The files that differ from where this branch left `main`, new ones too, from the root."""

    def git(*words: str) -> list[str]:
        command = ["git", "-c", "core.quotePath=false", *words]
        result = subprocess.run(command, cwd=root, capture_output=True, text=True, check=True)
        return result.stdout.splitlines()

    branches = git("for-each-ref", "--format=%(refname)")
    trunk = "main" if "refs/heads/main" in branches else "origin/main"
    paths = git("diff", "--no-renames", "--relative", "--name-only", "--merge-base", trunk)
    paths += git("ls-files", "--others", "--exclude-standard")
    if not paths:
        print(f"nothing differs from {trunk}: name a room to test it", file=sys.stderr)
    return set(paths)


def main(words: list[str], root: Path = ROOT) -> int:
    """Print the tests of the named rooms, or of what changed, and those that name its modules."""
    modules = {
        name: rooms_of(path.relative_to(root).as_posix())
        for package in PACKAGES
        for name, path in sources_of(root / package).items()
    }
    known = set().union(*modules.values())
    rooms = {word.strip("_/") for word in words}
    if unknown := sorted(rooms - known):
        names = ", ".join(name for name in sorted(known) if places_of({name}, root))
        print(f"no room {unknown[0]}: expected some of {names}", file=sys.stderr)
        return 2
    changes = {name for name, its in modules.items() if its & rooms}
    if not rooms:
        try:
            paths = changed(root)
        except (OSError, subprocess.CalledProcessError) as error:
            why = (getattr(error, "stderr", None) or str(error)).strip()
            said = f"no room was named, expected a branch main to compare with, got: {why}"
            print(said, file=sys.stderr)
            return 2
        rooms = set().union(*map(rooms_of, paths))
        for path in map(PurePosixPath, paths):
            if path.suffix == ".py":
                changes.add(_module_at(path))
            else:  # data of the modules beside it
                folder = ".".join((*path.parent.parts, ""))
                changes |= {name for name in modules if f"{name}.".startswith(folder or ".")}
    if EVERYTHING in rooms:
        print("tests")
        return 0
    places = places_of(ALWAYS | rooms, root)
    inside = tuple(f"{place}/" for place in places)
    named = {file for file, names in named_by_tests(root).items() if names & changes}
    others = sorted(file for file in named.difference(places) if not file.startswith(inside))
    told = f"quick tests of {' '.join(places)} and of {len(others)} files that name modules of it"
    print(told, file=sys.stderr)
    print(*places, *others)
    return 0


def _module_at(path: PurePosixPath) -> str:
    return ".".join(path.with_suffix("").parts).removesuffix(".__init__")


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
