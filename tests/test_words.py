"""Wording of the package: openings of docstrings, kinds of constants, one class for each name."""

import ast
import builtins
import re
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.rooms import sources_of

ROOT = Path(__file__).resolve().parents[1]

# A docstring opens with a noun phrase or an imperative, never with a relative clause.
RIDDLE = re.compile(
    r"(what|how|whether|that of|those of|the same|where|which|who|whose|when|as|of|by which)\b",
    re.IGNORECASE,
)

# A numeric constant says which of these it is, see CONTRIBUTING.md.
KIND = re.compile(r"(^ ?|\(|# )(physical|numerical|measured|chosen)\b", re.IGNORECASE)

# A name in backticks, such as `HeadModel` or `settle_1px_s`; not a symbol such as `C_l`.
NAME = re.compile(r"`((?:\w+\.)*(?:[a-z]\w*_\w*[a-z0-9]{2}|[A-Z][a-z]+[A-Za-z0-9]+))(?:\(\))?`")

# Names in backticks of other packages, and columns whose names code composes.
OTHERS = {"NextStep", "SameStep", "TensorProto", "DataType", "error_p05_px", "settle_2_5px_s"}

# `argument: description`, in a Google docstring.
ENTRY = re.compile(r"    \*{0,2}\w[\w, *]*: (.*)")


def text_of(node: ast.stmt | None) -> str:
    """The text of a string that stands alone, such as an attribute's docstring; else empty."""
    if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
        return node.value.value.strip() if isinstance(node.value.value, str) else ""
    return ""


def texts_of(tree: ast.Module) -> Iterator[str]:
    """Docstrings of a module's parts, their attributes, arguments and results."""
    for node in ast.walk(tree):
        if not isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            continue
        yield from filter(None, map(text_of, node.body))
        section = ""
        for line in (ast.get_docstring(node) or "").splitlines():
            if not line.startswith(" "):
                section = line
            elif section in ("Returns:", "Yields:"):
                yield line.strip()
                section = ""  # its first line alone opens a sentence
            elif section in ("Args:", "Attributes:") and (entry := ENTRY.match(line)):
                yield entry[1]


def is_numeric(node: ast.expr) -> bool:
    """True for an expression of numbers alone, such as `(2.0 * pi, -1)`."""
    parts = list(ast.walk(node))
    leaves = [part.value for part in parts if isinstance(part, ast.Constant)]
    others = ast.keyword | ast.Dict | ast.comprehension | ast.Subscript
    if any(isinstance(part, others) for part in parts):
        return False
    return bool(leaves) and all(type(leaf) in (int, float) for leaf in leaves)


def constants_without_kind(source: str) -> list[str]:
    """Names of a module's numeric `Final` constants whose description lacks its kind.

    The description is the docstring below, a comment in the same lines, or one at the head of
    the group of lines without a blank one that it stands in.
    """
    lines, body = source.splitlines(), ast.parse(source).body
    names = []
    for node, following in zip(body, [*body[1:], None], strict=True):
        if not isinstance(node, ast.AnnAssign) or "Final" not in ast.unparse(node.annotation):
            continue
        if node.value is None or not is_numeric(node.value):
            continue
        first = node.lineno - 1
        while first > 0 and lines[first - 1].strip():
            first -= 1
        comments = [line.partition("#")[2] for line in lines[first : node.end_lineno]]
        if not any(map(KIND.search, [text_of(following), *comments])):
            names.append(ast.unparse(node.target))
    return names


def words_of(source: str) -> set[str]:
    """Names, and words of strings, in a module's code; not those of its docstrings."""
    nodes = list(ast.walk(ast.parse(source)))
    alone = {node.value for node in nodes if isinstance(node, ast.Expr)}
    names = ("id", "attr", "arg", "name", "asname")
    texts = [getattr(node, name, None) or "" for node in nodes for name in names]
    texts += [
        node.value
        for node in nodes
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and node not in alone
    ]
    return set(re.findall(r"\w+", " ".join(text for text in texts if isinstance(text, str))))


def class_names(sources: dict[str, Path]) -> Counter[str]:
    """Number of modules that define each public class."""
    return Counter(
        node.name
        for path in sources.values()
        for node in ast.parse(path.read_text(encoding="utf-8")).body
        if isinstance(node, ast.ClassDef) and not node.name.startswith("_")
    )


@pytest.mark.parametrize("folder", ["vergence", "benchmarks", "tests"])
def test_docstrings_open_with_a_noun_phrase_or_an_imperative(folder):
    riddles = [
        f"{path.relative_to(ROOT)}: {text.splitlines()[0]}"
        for path in sorted((ROOT / folder).rglob("*.py"))
        for text in texts_of(ast.parse(path.read_text(encoding="utf-8")))
        if RIDDLE.match(text)
    ]
    assert riddles == []


def test_numeric_constants_say_their_kind():
    untold = [
        f"{module}.{name}"
        for module, path in sources_of(ROOT / "vergence").items()
        for name in constants_without_kind(path.read_text(encoding="utf-8"))
    ]
    assert untold == []


def test_no_two_public_classes_share_a_name():
    counts = class_names(sources_of(ROOT / "vergence"))
    assert {name for name, count in counts.items() if count > 1} == set()


def test_names_in_backticks_exist():
    paths = [
        path
        for folder in ("vergence", "benchmarks", "tests")
        for path in sorted((ROOT / folder).rglob("*.py"))
    ]
    sources = {path: path.read_text(encoding="utf-8") for path in paths}
    known = OTHERS.union(*map(words_of, sources.values()), *(path.parts for path in paths))
    known |= {path.stem for path in paths}
    stale = [
        f"{path.relative_to(ROOT)}: {name}"
        for path, source in sources.items()
        for name in NAME.findall(source)
        if not known.issuperset(name.split("."))
    ]
    assert stale == []


def named_in(node: ast.ClassDef | ast.FunctionDef, section: str) -> set[str]:
    """Names with an entry in a section of a docstring."""
    doc = ast.get_docstring(node) or ""
    part = re.search(rf"^{section}:\n((?: .*\n|\n)*)", f"{doc}\n", re.MULTILINE)
    entries = re.findall(r"^    (\w[\w, *]*): ", part[1], re.MULTILINE) if part else []
    return {name for entry in entries for name in re.findall(r"\w+", entry)}


def defined_in(node: ast.AST) -> set[str]:
    """Names of the parameters and attributes that a class or function defines."""
    kinds = {ast.arg: "arg", ast.Name: "id", ast.Attribute: "attr", ast.FunctionDef: "name"}
    return {getattr(part, kinds[type(part)]) for part in ast.walk(node) if type(part) in kinds}


def test_documented_arguments_attributes_and_errors_exist():
    trees = {
        path: ast.parse(path.read_text(encoding="utf-8"))
        for path in sources_of(ROOT / "vergence").values()
    }
    classes = {
        node.name: node
        for tree in trees.values()
        for node in ast.walk(tree)
        if isinstance(node, ast.ClassDef)
    }
    errors = {"LinAlgError", "ResetNeeded", *classes, *dir(builtins)}  # NumPy's and Gymnasium's
    stale = []
    for path, tree in trees.items():
        for node in ast.walk(tree):
            if not isinstance(node, ast.ClassDef | ast.FunctionDef):
                continue
            wrong = named_in(node, "Raises") - errors
            if named := named_in(node, "Args") | named_in(node, "Attributes"):
                bases = re.findall(r"\w+", " ".join(map(ast.unparse, getattr(node, "bases", []))))
                own = [node, *(classes[name] for name in bases if name in classes)]
                wrong |= named.difference(*map(defined_in, own))
            stale += [f"{path.relative_to(ROOT)}: {name}" for name in sorted(wrong)]
    assert stale == []


def test_a_riddle_is_found_wherever_it_stands():
    source = (
        '"""Module."""\nclass A:\n    """What it is.\n\n    Args:\n        b: how many.\n    """\n'
    )
    source += '    c: int\n    """Whether it is."""\n'
    found = [text.splitlines()[0] for text in texts_of(ast.parse(source)) if RIDDLE.match(text)]
    assert sorted(found) == ["What it is.", "Whether it is.", "how many."]


def test_a_constant_may_say_its_kind_below_beside_or_above():
    source = (
        "A: Final = 1.0\n\nB: Final = (1, 2)  # numerical\nC: Final = -3\n"
        '"""Speed, m/s (chosen)."""\n\n# Registers (physical).\nD: Final = 4\nE: Final = 2 * 5\n'
    )
    assert constants_without_kind(source) == ["A"]
