"""Rooms and doors: who imports what from where, and that each door offers what is used and no more."""

import ast
import re
from collections import defaultdict
from collections.abc import Iterator
from functools import lru_cache
from importlib import import_module
from pathlib import Path
from typing import NamedTuple

import pytest

from cbsr_qa.lazy import listed

TOP = Path(__file__).resolve().parents[1]
ROOTS = {"cbsr_qa": TOP / "cbsr_qa", "cbsr_qa_plugins": TOP / "plugins" / "cbsr_qa_plugins"}


def _names(root: str, base: Path) -> dict[str, Path]:
    found = {}
    for path in base.rglob("*.py"):
        parts = (root, *path.relative_to(base).with_suffix("").parts)
        found[".".join(parts).removesuffix(".__init__")] = path
    return found


MODULES = {name: path for root, base in ROOTS.items() for name, path in _names(root, base).items()}
PACKAGES = {name for name, path in MODULES.items() if path.name == "__init__.py"}
DOORS = {name: MODULES[name] for name in PACKAGES if listed(MODULES[name].read_text())}


class Import(NamedTuple):
    """``from module import name`` by somebody whose package is ``home``; an empty one belongs to no package."""

    who: str
    home: str
    module: str
    name: str


def _imports(source: str, who: str, home: str) -> Iterator[Import]:
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.ImportFrom) and node.module and not node.level:
            yield from (Import(who, home, node.module, alias.name) for alias in node.names)
        elif isinstance(node, ast.Import):
            yield from (Import(who, home, alias.name, "") for alias in node.names)
        elif isinstance(node, ast.keyword) and node.arg == "prints" and isinstance(node.value, ast.Constant):
            module, _, names = str(node.value.value).partition(":")  # of a command, imported only for its schema
            yield from (Import(who, home, module, name) for name in names.split("|"))


def _home_of_test(path: Path) -> str:
    folder = path.relative_to(TOP / "tests").parent.parts
    return ".".join(("cbsr_qa", *folder)) if folder and folder[0] != "plugins" else ""


@lru_cache(maxsize=1)
def _all_imports() -> tuple[Import, ...]:
    found: list[Import] = []
    for name, path in MODULES.items():
        home = name if name in PACKAGES else name.rpartition(".")[0]
        found += _imports(path.read_text(), name, home)
    for folder in ("tests", "benchmarks", "docs", "migrations"):
        for path in sorted((TOP / folder).rglob("*.py")):
            found += _imports(path.read_text(), str(path), _home_of_test(path) if folder == "tests" else "")
    for page in [TOP / "README.md", *sorted((TOP / "docs").rglob("*.md"))]:
        for block in re.findall(r"^```python\n(.*?)^```", page.read_text(), re.M | re.S):
            try:
                found += _imports(block, str(page), "")
            except SyntaxError:  # an excerpt
                continue
    return tuple(found)


def _offered(door: str) -> dict[str, str]:
    """Name → module that a door takes it from; a module it offers whole is its own."""
    found = {}
    for node in listed(DOORS[door].read_text()):
        assert node.level == 1, f"{DOORS[door]}:{node.lineno} takes from another package"
        for alias in node.names:
            assert alias.name != "*", f"{DOORS[door]}:{node.lineno} has a star"
            found[alias.asname or alias.name] = f"{door}.{node.module or alias.name}"
    return found


def test_modules_of_other_packages_are_imported_through_their_door():
    past = [
        f"{made.who} imports {made.name} from {made.module}"
        for made in _all_imports()
        if made.module.startswith("cbsr_qa.") and made.module in MODULES and made.module not in PACKAGES
        for room in (made.module.rpartition(".")[0],)
        if room != "cbsr_qa" and made.home != room and not made.home.startswith(f"{room}.")
    ]
    assert past == []


def _may_take_whole(made: Import) -> bool:
    """Whether a room takes a part of its own, or a test a module in which it is going to change a name."""
    below = f"{made.module}.{made.name}"
    return below in MODULES and (below in PACKAGES or made.who not in MODULES or made.home.startswith(made.module))


def _documented() -> set[str]:
    """Names of the root that the reference explains to users: each has an example there."""
    page = (TOP / "docs" / "reference" / "python.md").read_text()
    return set(re.findall(r"^### `(\w+)", page, re.M))


def test_a_door_offers_what_somebody_outside_uses_and_nothing_else():
    used = defaultdict(set)
    for made in _all_imports():
        if made.module in DOORS and made.home != made.module and not _may_take_whole(made):
            used[made.module].add(made.name)
    for door in DOORS:  # what one door takes from another is used there
        for name, module in _offered(door).items():
            if module in DOORS:
                used[module].add(name)
    used["cbsr_qa"] |= _documented()
    beside = {"", "__version__"}  # of the root
    unused = {door: sorted(set(_offered(door)) - used[door]) for door in DOORS}
    absent = {door: sorted(used[door] - set(_offered(door)) - beside) for door in DOORS}
    assert {door: names for door, names in unused.items() if names} == {}
    assert {door: names for door, names in absent.items() if names} == {}


def _named_like_their_module(source: str) -> list[str]:
    """Names that a door takes from a module of the same name: once that is imported, it hides them."""
    offered = ((node.module, alias) for node in listed(source) for alias in node.names)
    return [alias.name for module, alias in offered if module == (alias.asname or alias.name)]


def test_no_door_offers_a_name_that_its_own_module_hides():
    block = "if TYPE_CHECKING:\n    "
    assert _named_like_their_module(f"{block}from .gauge import gauge as gauge, study as study") == ["gauge"]
    assert _named_like_their_module(f"{block}from . import gauge as gauge") == []
    assert {door: names for door in DOORS if (names := _named_like_their_module(DOORS[door].read_text()))} == {}


@pytest.mark.parametrize("door", sorted(DOORS))
def test_a_door_gives_what_it_lists_and_no_module_stands_in_its_way(door):
    """Importing a module makes it an attribute of its package: it must not be named as something the door offers."""
    offered = _offered(door)
    package = import_module(door)
    assert sorted(package.__all__) == sorted(offered)
    for name, module in offered.items():
        if f"{door}.{name}" == module:
            assert getattr(package, name) is import_module(module)
            continue
        assert f"{door}.{name}" not in MODULES, f"{door}.{name} is a module and a name"
        assert getattr(package, name) is getattr(import_module(module), name)


def test_every_package_says_what_it_is_for():
    for name in PACKAGES:
        assert ast.get_docstring(ast.parse(MODULES[name].read_text())), name


def _graph() -> dict[str, set[str]]:
    """Module → modules it imports, at its top or later, seen through doors."""

    def source(module: str, name: str) -> str:
        if f"{module}.{name}" in MODULES:
            return f"{module}.{name}"
        while module in DOORS and name in _offered_of[module]:
            module = _offered_of[module][name]
        return module

    _offered_of = {door: _offered(door) for door in DOORS}
    edges = defaultdict(set)
    for made in _all_imports():
        if made.who in MODULES:
            edges[made.who].add(source(made.module, made.name))
    return {who: {other for other in others if other in MODULES and other != who} for who, others in edges.items()}


def test_no_module_imports_itself_by_way_of_others():
    """Local imports count: a circle they hide is one all the same."""
    edges, done = _graph(), set()

    def visit(module: str, way: tuple[str, ...]) -> None:
        assert module not in way, " → ".join([*way[way.index(module) :], module])
        if module not in done:
            for other in sorted(edges.get(module, ())):
                visit(other, (*way, module))
            done.add(module)

    for module in sorted(MODULES):
        visit(module, ())
