"""A package from the templates works as it is, for every kind of plugin, and replaces nothing."""

import importlib
import os
import subprocess
import sys
from dataclasses import replace

import pytest
from pages import TOP, blocks
from scanning_rig import TabledWorld
from simulated_setting import MOTION, context

from cbsr_qa.cli import main
from cbsr_qa.domain.errors import ConfigError
from cbsr_qa.domain.plan.plan import InstrumentSpec
from cbsr_qa.plugin import Kind, RefusedError
from cbsr_qa.plugin.discovery import discover
from cbsr_qa.simulate.instruments.rig import EmulatedRig, Emulation
from cbsr_qa.simulate.instruments.streams import WatchedClock
from cbsr_qa.testing import assert_conforms
from cbsr_qa.testing.kit.new import make_package

#: What they use of Python is typed; tests/interface/test_python_pages.py runs it.
PAGES = (TOP / "docs" / "tutorials" / "first-sensor-in-a-notebook.md", TOP / "docs" / "reference" / "python.md")
PLUGINS = discover()


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A package of each kind."""
    into = tmp_path_factory.mktemp("packages")
    return {kind: make_package(kind, f"made-{kind}", PLUGINS, into) for kind in Kind}


@pytest.fixture(autouse=True)
def own_path(monkeypatch):
    """Folders of packages stay on the path of one test."""
    monkeypatch.setattr(sys, "path", [*sys.path])


@pytest.mark.parametrize("kind", [kind for kind in Kind if kind is not Kind.RECONSTRUCTION])
def test_a_new_package_conforms_without_being_installed(made, kind):
    """A reconstruction takes seconds; tests/commands/test_plugin_tutorial.py checks one."""
    assert_conforms(made[kind].folder)


def test_the_emulator_of_a_new_instrument_answers_where_a_station_says_emulated(made):
    package, plugins, clock = made[Kind.INSTRUMENT], discover(), WatchedClock()
    sys.path.append(str(package.folder))
    plugins.add(importlib.import_module(package.module), package.distribution, "0", "made")
    spec = InstrumentSpec("room", package.name, ("temperature",), {"address": "emulated"}, None)
    with Emulation([spec], EmulatedRig(clock, TabledWorld(), MOTION), plugins.emulator) as emulation:
        told = replace(context(None, clock=clock), role="room", options=dict(emulation.fill_address(spec).options))
        instrument = plugins.factory(Kind.INSTRUMENT, package.name)(told)
        clock.sleep(1.0)
        assert instrument.samples_since(0.0).values.tolist() == [21.5]
        instrument.close()


def test_an_emulated_address_of_a_driver_that_has_no_emulator_is_refused_with_what_adds_one():
    spec = InstrumentSpec("bridge", "phidget-bridge", ("force",), {"address": "emulated"}, None)
    rig = EmulatedRig(WatchedClock(), TabledWorld(), MOTION)
    with pytest.raises(ConfigError, match=r"phidget-bridge.*no emulator") as refused:
        Emulation([spec], rig, PLUGINS.emulator)
    assert "cbsr_emulator" in refused.value.remedy


def _done(*words, cwd, **environment):
    command = [sys.executable, "-m", *words]
    return subprocess.run(
        command, cwd=cwd, env={**os.environ, **environment}, capture_output=True, text=True, check=False
    )


def test_new_packages_are_formatted_and_pass_ruff(made):
    folder = made[Kind.METRIC].folder.parent
    for words in (("ruff", "check", "."), ("ruff", "format", "--check", ".")):
        done = _done(*words, "--no-cache", cwd=folder)
        assert done.returncode == 0, done.stdout


def test_a_long_and_a_short_name_leave_the_code_formatted(tmp_path):
    for kind in Kind:
        make_package(kind, "a", PLUGINS, _folder(tmp_path, f"short-{kind}"))
        make_package(kind, "a-name-of-many-letters-x", PLUGINS, _folder(tmp_path, f"long-{kind}"))
    for words in (("ruff", "check", "."), ("ruff", "format", "--check", ".")):
        done = _done(*words, "--no-cache", cwd=tmp_path)
        assert done.returncode == 0, done.stdout


def _folder(parent, name):
    (parent / name).mkdir()
    return parent / name


@pytest.mark.rest
def test_new_packages_and_the_pages_on_python_are_strictly_typed(made, tmp_path):
    """Both at once: mypy needs ten seconds to load what it knows of this project."""
    modules = [str(package.folder / package.module) for package in made.values()]
    path = os.pathsep.join(str(package.folder) for package in made.values())
    for page in PAGES:
        module = tmp_path / f"{page.stem.replace('-', '_')}.py"
        module.write_text("\n".join(blocks(page, "python")))
        modules.append(str(module))
    done = _done("mypy", *modules, cwd=TOP, MYPYPATH=path)  # with the settings and what is known of `make types`
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.rest
def test_the_test_of_a_new_package_runs_under_pytest(made):
    done = _done("pytest", "-q", "-p", "no:cacheprovider", cwd=made[Kind.SEQUENCE].folder)
    assert "1 passed" in done.stdout, done.stdout + done.stderr


@pytest.mark.parametrize(
    ("kind", "name", "named"),
    [
        (Kind.METRIC, "Peak-Force", "'Peak-Force' cannot be the name"),
        (Kind.METRIC, "peak_force", "'peak_force' cannot be the name"),
        (Kind.METRIC, "-peak", "'-peak' cannot be the name"),
        (Kind.METRIC, "../peak", "'../peak' cannot be the name"),
        (Kind.METRIC, "", "'' cannot be the name"),
        (Kind.METRIC, "p" * 25, "cannot be the name"),
        (Kind.METRIC, "applied-force", "metric 'applied-force' is already registered by cbsr-qa"),
        (Kind.SEQUENCE, "plugins", "a module cbsr_qa_plugins is installed already"),
    ],
)
def test_a_name_that_is_not_allowed_or_taken_is_refused(tmp_path, kind, name, named):
    with pytest.raises(RefusedError) as refused:
        make_package(kind, name, PLUGINS, tmp_path)
    assert named in refused.value.reason
    assert refused.value.remedy
    assert list(tmp_path.iterdir()) == []


def test_a_folder_is_not_overwritten(tmp_path):
    (tmp_path / "cbsr-qa-peak").mkdir()
    (tmp_path / "cbsr-qa-peak" / "mine.txt").write_text("kept")
    with pytest.raises(RefusedError, match="exists already"):
        make_package(Kind.METRIC, "peak", PLUGINS, tmp_path)
    with pytest.raises(RefusedError, match="is not a folder"):
        make_package(Kind.METRIC, "peak", PLUGINS, tmp_path / "absent")
    assert [path.name for path in tmp_path.rglob("*.*")] == ["mine.txt"]


def test_new_names_the_kinds_there_are(capsys):
    assert main.run_guarded(["plugins", "new", "metrik", "peak"]) == 2
    assert "did you mean 'metric'?" in capsys.readouterr().err
