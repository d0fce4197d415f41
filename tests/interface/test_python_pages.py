"""The pages on Python run as printed, in one folder, and what they use is typed."""

import matplotlib as mpl
import pytest
from pages import TOP, blocks

import cbsr_qa as qa

pytest.importorskip("pandas")
pytest.importorskip("xarray")

_TUTORIAL = TOP / "docs" / "tutorials" / "first-sensor-in-a-notebook.md"
_REFERENCE = TOP / "docs" / "reference" / "python.md"


@pytest.fixture(autouse=True)
def _in_a_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    mpl.use("Agg")


@pytest.mark.rest
def test_the_tutorial_runs_as_printed(capfd):
    namespace = {}
    exec("\n".join(blocks(_TUTORIAL, "python")), namespace)
    printed = capfd.readouterr()
    assert " ± " in printed.out
    assert "press 23 of 23" in printed.out
    assert printed.err == ""
    assert len(namespace["overlap"].groupby("serial")) == 2
    _check_run(namespace["run"])


def _check_run(run):
    stored = qa.open_database().run(run.run)
    assert repr(stored).splitlines()[:2] == repr(run).splitlines()[:2]
    left = {"compute_s", "reconstruction", "place"}
    one, other = ({k: v for k, v in each.to_dict().items() if k not in left} for each in (run, stored))
    assert one == other


@pytest.mark.rest
def test_the_reference_runs_as_printed():
    exec("\n".join(blocks(_REFERENCE, "python")), {})


@pytest.mark.rest
def test_what_the_pages_use_is_typed(tmp_path):
    for page in (_TUTORIAL, _REFERENCE):
        (tmp_path / f"{page.stem.replace('-', '_')}.py").write_text("\n".join(blocks(page, "python")))
    mypy = pytest.importorskip("mypy.api")
    options = ["--config-file", str(TOP / "pyproject.toml"), "--follow-imports=silent"]
    out, _, code = mypy.run([*options, *map(str, tmp_path.glob("*.py"))])
    assert code == 0, out
