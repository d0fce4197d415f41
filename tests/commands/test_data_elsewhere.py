"""The page on taking data elsewhere, typed and run as printed on a database of five runs."""

import shutil
from pathlib import Path

import pytest
import scipy.io
from command import cbsr_qa
from exported_runs import five_runs
from pages import HOW_TO, blocks, commands, typed

PAGE = HOW_TO / "take-your-data-elsewhere.md"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("elsewhere")
    (folder / "var").mkdir()
    shutil.copy(Path(five_runs()[0].removeprefix("sqlite:///")), folder / "var" / "cbsr-qa.db")
    for command in commands(PAGE):
        assert "✓ exported" in typed(folder, command).stdout, command
    return folder


@pytest.mark.rest
def test_the_snippets_run_on_what_the_commands_wrote(folder, monkeypatch, capsys):
    monkeypatch.chdir(folder)
    tables, view, frames = blocks(PAGE, "python")
    exec(tables, {})
    assert "S-1" in capsys.readouterr().out
    exec(view, found := {})
    assert found["runs"].verdict.tolist()[:2] == ["marginal", "fail"]
    assert "centre of mass error (L0) is 7.25 mm" in capsys.readouterr().out
    exec(frames, read := {})
    assert read["used"].sizes["time"] == 1
    assert int(read["used"].notnull().sum()) <= 208
    read["frames"].close()


def test_the_commands_wrote_what_their_options_select(folder):
    assert (folder / "outcomes.xml").read_text().count("<testsuite ") == 4  # the fifth run is of another recipe
    assert len((folder / "runs.csv").read_text().splitlines()) == 1 + 5
    refused = cbsr_qa(folder, "export", "S-1", "--failed", "--to", "x.csv", check=False)
    assert (refused.returncode, (folder / "x.csv").exists()) == (2, False)
    assert "a RUN, and options that select runs" in refused.stderr


def test_every_variable_is_named_on_the_page(folder):
    xarray = pytest.importorskip("xarray")
    page = PAGE.read_text()
    with xarray.open_dataset(folder / "frames.nc") as frames:
        unnamed = {name for name in frames.variables if f"`{name}`" not in page}
    assert unnamed == {"drive", "measure", "electrode"} - {
        name for name in ("drive", "measure") if f"`{name}`" in page
    }
    beside = scipy.io.loadmat(folder / "frames.mat", simplify_cells=True)["cbsr"]
    of_run = {"title", "source", "run", "batch", "sensor_type", "material", "recipe", "operator", "started_at", "end",
              "parts", "failure_codes"}  # fmt: skip
    unnamed = {name for name in beside if f"`cbsr.{name}`" not in page and f"(`cbsr.{name}`" not in page}
    assert unnamed - {"unit"} == of_run | {"verdict", "software", "head"}
