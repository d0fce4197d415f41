"""The hand-written package list against the disk."""

import ast
import re
import sys
import tomllib
from pathlib import Path

import cbsr_qa

_TOP = Path(__file__).resolve().parents[2]
_PROJECT = tomllib.loads((_TOP / "pyproject.toml").read_text())
_SETUPTOOLS = _PROJECT["tool"]["setuptools"]


def _name(requirement: str) -> str:
    return re.split(r"[>\[]", requirement, maxsplit=1)[0]


def _packages_on_disk() -> set[str]:
    found = set()
    for package, folder in _SETUPTOOLS["package-dir"].items():
        for init in (_TOP / folder).rglob("__init__.py"):
            below = init.parent.relative_to(_TOP / folder).parts
            found.add(".".join([package, *below]))
    return found


def test_every_package_on_disk_is_listed_and_the_other_way_round():
    assert set(_SETUPTOOLS["packages"]) == _packages_on_disk()


def test_every_python_file_is_in_a_package():
    for folder in _SETUPTOOLS["package-dir"].values():
        for module in (_TOP / folder).rglob("*.py"):
            assert (module.parent / "__init__.py").exists() or "migrations" in module.parts, module


def test_every_data_file_is_matched_by_a_pattern():
    for package, patterns in _SETUPTOOLS["package-data"].items():
        top = _TOP / _SETUPTOOLS["package-dir"].get(package, package.replace(".", "/"))
        matched = {path for pattern in patterns for path in top.glob(pattern)}
        data = {
            p
            for p in top.rglob("*")
            if p.is_file() and p.suffix not in {".py", ".pyc"} and "__pycache__" not in p.parts
        }
        if package == "cbsr_qa":
            data = {p for p in data if p.name == "py.typed"}
        assert data <= matched, (package, sorted(data - matched))


def test_runtime_dependencies_are_the_imported_ones():
    """A dependency nobody imports, or an import nobody declares, is found here."""
    names = {"google-re2": "re2", "pyserial": "serial", "pyvisa-py": "pyvisa_py", "scikit-image": "skimage"}
    backends = {"pyvisa-py"}  # loaded by pyvisa
    declared = set(map(_name, _PROJECT["project"]["dependencies"]))
    modules = {names.get(d, d): d for d in declared - backends}
    extra = _PROJECT["project"]["optional-dependencies"]
    # The command that opens this room refuses, with a remedy, where its extra is absent.
    of_web = {{"pillow": "PIL"}.get(name, name) for name in map(_name, extra["web"])}
    imported = set()
    for folder in ("cbsr_qa", "plugins", "migrations"):
        for module in (_TOP / folder).rglob("*.py"):
            before = set(imported)
            for node in ast.walk(ast.parse(module.read_text())):
                if isinstance(node, ast.Import):
                    imported |= {alias.name.split(".")[0] for alias in node.names}
                elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
                    imported.add(node.module.split(".")[0])
            if module.is_relative_to(_TOP / "cbsr_qa" / "web"):
                imported -= of_web - before
            if module.is_relative_to(_TOP / "cbsr_qa" / "interface"):  # for types; else by name, with a remedy
                imported -= set(map(_name, extra["notebook"])) - before
    foreign = imported - set(sys.stdlib_module_names) - {"cbsr_qa", "cbsr_qa_plugins"}
    extras = {name for lines in extra.values() for name in map(_name, lines)}
    optional = {"pyeit", "pyarrow"}  # imported by name, and refused with a remedy where it is absent
    assert optional <= extras
    assert not foreign & optional, "an extra is imported as if it were always there"
    assert set(modules) <= imported, "declared but never imported"
    parts = {"markupsafe", "pydantic_core"}  # of jinja2 and pydantic, which require exactly the one that fits
    assert foreign <= set(modules) | parts, "imported but not declared"


def test_the_page_on_installing_lists_every_extra_with_its_packages():
    page = (_TOP / "docs" / "how-to" / "install.md").read_text()
    listed = {
        extra: set(packages.split(", ")) for extra, packages in re.findall(r"^\| `(\w+)` \|.*\| (.*) \|$", page, re.M)
    }
    extras = _PROJECT["project"]["optional-dependencies"]
    assert listed == {
        extra: set(map(_name, lines)) for extra, lines in extras.items() if extra not in ("docs", "test", "dev")
    }


def test_the_licence_is_stated_and_goes_into_the_wheel():
    project = _PROJECT["project"]
    assert project["license"] == "BSD-3-Clause"
    (file,) = project["license-files"]
    assert (
        (_TOP / file).read_text().startswith("BSD 3-Clause License\n\nCopyright (c) 2026, the cbsr-qa developers\n")
    )


def test_citation_changelog_and_the_page_on_installing_state_the_version():
    cited = dict(re.findall(r"^(version|license): (.*)$", (_TOP / "CITATION.cff").read_text(), re.M))
    assert cited == {"version": cbsr_qa.__version__, "license": _PROJECT["project"]["license"]}
    assert f"## [{cbsr_qa.__version__}]" in (_TOP / "CHANGELOG.md").read_text(), "the changelog has no such version"
    assert f"cbsr_qa-{cbsr_qa.__version__}-py3-none-any.whl" in (_TOP / "docs" / "how-to" / "install.md").read_text()
