"""Who imports what: doors of rooms, no circles, what a plugin author may rely on. Layers are in pyproject.toml."""

import ast
import re
from collections import defaultdict
from collections.abc import Iterator, Mapping
from functools import cache
from pathlib import Path
from typing import NamedTuple

TOP = Path(__file__).resolve().parents[1]
ROOTS = {"cbsr_qa": TOP / "cbsr_qa", "cbsr_qa_plugins": TOP / "plugins" / "cbsr_qa_plugins"}
#: Packages whose names others import from the package itself.
DOORS = {"cbsr_qa", "cbsr_qa.calibration", "cbsr_qa.interface", "cbsr_qa.plugin", "cbsr_qa.testing"}


def list_modules() -> dict[str, Path]:
    modules = {}
    for root, folder in ROOTS.items():
        for path in folder.rglob("*.py"):
            parts = (root, *path.relative_to(folder).with_suffix("").parts)
            modules[".".join(parts).removesuffix(".__init__")] = path
    return modules


MODULES = list_modules()
PACKAGES = {name for name, path in MODULES.items() if path.name == "__init__.py"}


class Import(NamedTuple):
    """``from module import name``."""

    importer: str
    module: str
    name: str

    @property
    def imported(self) -> str:
        """The module that is loaded by it."""
        return below if (below := f"{self.module}.{self.name}") in MODULES else self.module


def read_imports(importer: str, source: str) -> Iterator[Import]:
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.ImportFrom):
            assert node.module, f"{importer} has a relative import"
            yield from (Import(importer, node.module, alias.name) for alias in node.names)
        elif isinstance(node, ast.Import):
            yield from (Import(importer, alias.name, "") for alias in node.names)


@cache
def list_imports() -> list[Import]:
    """Return all imports of the product; not at import, since every worker of the tests imports this file."""
    return [made for name, path in MODULES.items() for made in read_imports(name, path.read_text(encoding="utf-8"))]


def author_imports() -> Iterator[Import]:
    """Yield imports of those who write plugins: built-in ones, new packages, examples of the documentation."""
    listing = "cbsr_qa_plugins.registry"  # is loaded to list what there is, without what the door loads
    theirs = [
        made for made in list_imports() if made.importer.startswith("cbsr_qa_plugins") and made.importer != listing
    ]
    yield from theirs
    for template in (TOP / "cbsr_qa" / "testing" / "kit" / "templates").iterdir():
        lines = re.findall(r"^from cbsr_qa[\w.]* import (?:\([^)]*\)|.*)$", template.read_text(), re.M)
        yield from read_imports(str(template), "\n".join(lines))
    pages = [TOP / "README.md", *sorted((TOP / "docs").rglob("*.md"))]
    for page in pages:
        if page.name == "use-the-eit-engine.md":  # without what cbsr_qa.plugin needs
            continue
        for block in re.findall(r"^```python\n(.*?)^```", page.read_text(), re.M | re.S):
            lines = re.findall(r"^from cbsr_qa[\w.]* import (?:\([^)]*\)|.*)$", block, re.M)
            yield from read_imports(str(page), "\n".join(lines))


def test_only_doors_hand_on_names():
    """Another package's ``__init__`` says what it is for; its names are imported from their modules."""
    importing = {
        made.importer for made in list_imports() if made.importer in PACKAGES and made.imported.startswith("cbsr_qa")
    }
    assert importing - DOORS == {"cbsr_qa.studies.hard_cases.cases"}  # which lists its modules


def test_every_package_says_what_it_is_for():
    for name in PACKAGES:
        assert ast.get_docstring(ast.parse(MODULES[name].read_text())), name


def test_the_door_of_plugins_offers_what_their_authors_use():
    offered = {made.name: made.module for made in list_imports() if made.importer == "cbsr_qa.plugin.api"}
    used = list(author_imports())
    past = {made for made in used if offered.get(made.name) == made.module}
    assert past == set(), "these stand in cbsr_qa.plugin"
    interfaces = {name for name, module in offered.items() if not module.startswith("cbsr_qa.domain")}
    unused = set(offered) - {made.name for made in used if made.module == "cbsr_qa.plugin"} - interfaces
    assert unused == set()


def find_circle(edges: Mapping[str, set[str]]) -> list[str]:
    """Return nodes of a directed graph that lead back to the first; empty without any."""
    done: set[str] = set()

    def visit(node: str, way: tuple[str, ...]) -> list[str]:
        if node in way:
            return [*way[way.index(node) :], node]
        if node not in done:
            for other in sorted(edges.get(node, ())):
                if circle := visit(other, (*way, node)):
                    return circle
            done.add(node)
        return []

    return next((circle for node in sorted(edges) if (circle := visit(node, ()))), [])


def test_a_circle_is_found():
    assert find_circle({"a": {"b"}, "b": {"c"}, "c": set()}) == []
    assert find_circle({"a": {"b"}, "b": {"c", "d"}, "d": {"b"}}) == ["b", "d", "b"]


def test_no_module_imports_itself_by_way_of_others():
    """Local imports count: a circle that they hide is one all the same."""
    edges = defaultdict(set)
    for made in list_imports():
        if made.imported in MODULES and made.imported != made.importer and made.importer != "cbsr_qa":
            edges[made.importer].add(made.imported)
    assert find_circle(edges) == []


def test_no_package_needs_one_that_needs_it():
    """Packages of one room, and modules beside them."""
    edges = defaultdict(set)
    for made in list_imports():
        importer, imported = (".".join(name.split(".")[:3]) for name in (made.importer, made.imported))
        if importer != imported and importer.count(".") == imported.count(".") == 2:
            edges[importer].add(imported)
    assert find_circle(edges) == []
