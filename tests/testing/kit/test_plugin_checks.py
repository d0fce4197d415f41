"""Each check of plugins can fail, and says then what was found, what is allowed and what to change."""

import json
import sys
from dataclasses import replace

import pytest

from cbsr_qa.cli import main
from cbsr_qa.plugin import Kind, PluginError
from cbsr_qa.plugin.discovery import Plugins, discover
from cbsr_qa.testing import assert_conforms, sinks
from cbsr_qa.testing.kit.conformance import CheckOutcome, carry_out, check_plugins, documentation_checks
from cbsr_qa.testing.kit.new import make_package
from cbsr_qa.testing.kit.package import targets_of

PLUGINS = discover()


@pytest.fixture(autouse=True)
def own_path(monkeypatch):
    """Folders of packages stay on the path of one test."""
    monkeypatch.setattr(sys, "path", [*sys.path])


#: Kind, file, text in it and what takes its place → the check that fails, and words of what it found.
_FAULTS = [
    ("metric", "metric", "class Fault", "class Other", "import", "has no attribute"),
    ("metric", "metric", "    after_s : samples", "    before_s : samples", "documentation", "option after_s"),
    ("metric", "metric", '    """Measure the', '    text = """Measure the', "documentation", "the plugin"),
    ("metric", "metric", '"N"}', '"kg"}', "measurements", "is not among"),
    ("metric", "metric", "max(peaks)", "float('nan')", "measurements", "nan"),
    ("metric", "metric", "max(peaks)", "float(__import__('time').perf_counter())", "repeated measurements", "other"),
    ("metric", "__init__", "after_s", "befor_s", "example", "befor_s"),
    ("metric", "__init__", "def cbsr_example", "def cbsr_exampel", "hooks", "no such hook: cbsr_exampel"),
    ("metric", "__init__", '    """Add the metric."""\n', "", "hooks", "no docstring: cbsr_register"),
    (
        "instrument",
        "__init__",
        "    return Example",
        "    port.close()\n    return None\n    Example",
        "example",
        "no example",
    ),
    (
        "instrument",
        "instrument",
        "new = np.array([now_s]) > time_s",
        "new = [True]; now_s = 0.0",
        "sampler",
        "when asked",
    ),
    ("sequence", "sequence", "strain_percent / 100", "strain_percent", "dry run", "strain"),
    (
        "sequence",
        "sequence",
        "100, trial)",
        "100, __import__('time').perf_counter_ns())",
        "same steps",
        "other steps",
    ),
    ("effect", "effect", 'perturbs = "voltages"', 'perturbs = "volts"', "scene", "perturbs 'volts'"),
    (
        "recording",
        "recording",
        'raise RecordingError(f"{path.name} line {number} has',
        'raise IndexError(f"',
        "damaged file",
        "IndexError",
    ),
    ("section", "section", "yield Paragraph(", "yield str(", "rendering", ""),
    ("sink", "sink", '"a", encoding', '"w", encoding', "delivery", "instead of"),
]


def _package(folder, kind, name):
    return make_package(Kind(kind), name, PLUGINS, folder)


def _failed(asked):
    return [each for each in check_plugins(targets_of(str(asked))).checks if each.outcome is CheckOutcome.FAILED]


@pytest.mark.parametrize("number", range(len(_FAULTS)), ids=lambda n: f"{_FAULTS[n][0]} {_FAULTS[n][4]} {n}")
def test_a_fault_fails_its_check_with_a_remedy(tmp_path, monkeypatch, number):
    monkeypatch.setattr(sinks, "_ARRIVAL_S", 0.1)
    kind, file, text, instead, check, found = _FAULTS[number]
    package = _package(tmp_path, kind, f"fault-x{number}")
    path = package.folder / package.module / f"{file}.py"
    source = path.read_text()
    assert text in source
    path.write_text(source.replace(text, instead, 1))
    failed, *_ = _failed(package.folder)
    assert failed.check == check
    assert found in failed.found
    assert failed.allowed
    assert failed.remedy


def test_the_test_of_a_package_lists_found_allowed_and_remedy(tmp_path):
    package = _package(tmp_path, "section", "silent-section")
    path = package.folder / package.module / "section.py"
    path.write_text(path.read_text().replace("yield Paragraph(", "yield str("))
    with pytest.raises(AssertionError, match=r"(?s)section silent-section: rendering\nfound: .*allowed: .*remedy: "):
        assert_conforms(package.folder)


@pytest.mark.parametrize("registration", PLUGINS.registrations(), ids=lambda r: f"{r.kind} {r.name}")
def test_every_built_in_plugin_is_documented(registration):
    for check in documentation_checks(PLUGINS, registration.kind, registration.name):
        (line,) = carry_out(registration.kind, registration.name, check)
        assert line.outcome is CheckOutcome.PASSED, line


@pytest.mark.parametrize("name", ["applied-force", "simulated-bench", "noise-figure", "creep"])
def test_a_built_in_plugin_is_checked_by_name(name):
    assert _failed(name) == []


def test_the_command_prints_checks_and_ends_with_1_if_one_failed(tmp_path, capsys):
    package = _package(tmp_path, "sequence", "shown-sequence")
    assert main.run_guarded(["plugins", "check", str(package.folder)]) == 0
    assert "✓ 8 checks passed" in capsys.readouterr().out
    broken = _package(tmp_path, "sequence", "broken-sequence")
    path = broken.folder / broken.module / "sequence.py"
    path.write_text(path.read_text().replace("strain_percent / 100", "strain_percent"))
    assert main.run_guarded(["plugins", "check", str(broken.folder), "--json"]) == 1
    document = json.loads(capsys.readouterr().out)
    assert (document["passed"], document["failed"]) == (7, 1)
    assert {"kind", "name", "check", "outcome", "found", "allowed", "remedy"} == set(document["checks"][0])
    assert main.run_guarded(["plugins", "check", str(broken.folder)]) == 1
    out = capsys.readouterr().out
    for words in ("1 of 8 checks failed", "What to change", "found: ", "allowed: ", "remedy: stay within"):
        assert words in out


def test_without_a_name_the_plugins_of_other_packages_are_checked(monkeypatch):
    ours = [one for one in PLUGINS.registrations() if one.distribution == "cbsr-qa"]
    others = [replace(one, distribution="mine") for one in ours if one.name == "noise-figure"]
    monkeypatch.setattr(Plugins, "registrations", lambda self, kind=None: ours)
    with pytest.raises(PluginError, match="no plugin of another package is installed"):
        targets_of(None)
    monkeypatch.setattr(Plugins, "registrations", lambda self, kind=None: [*ours, *others])
    assert [name for _, name in targets_of(None).names] == ["noise-figure", "noise-figure"]


def test_what_cannot_be_checked_is_refused(tmp_path, capsys):
    assert main.run_guarded(["plugins", "check", "applied-farce"]) == 2
    assert "did you mean 'applied-force'?" in capsys.readouterr().err
    (tmp_path / "pyproject.toml").write_text('[project]\nname = "mine"\n')
    with pytest.raises(PluginError, match=r"no table .project.entry-points.cbsr_qa."):
        targets_of(str(tmp_path))
    (tmp_path / "pyproject.toml").write_text('[project]\nname = "m"\n[project.entry-points.cbsr_qa]\nm = "no_such_m"')
    with pytest.raises(PluginError, match="no_such_m"):
        targets_of(str(tmp_path))
    (tmp_path / "pyproject.toml").write_text("[project")
    with pytest.raises(PluginError, match="is not TOML"):
        targets_of(str(tmp_path))
    with pytest.raises(PluginError, match="cannot be read"):
        targets_of(str(tmp_path / "absent"))
