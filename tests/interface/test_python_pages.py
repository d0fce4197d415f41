"""The pages on Python run as printed, in one folder and with a shorter recipe."""

import matplotlib as mpl
import pytest
from force_calibration import force_calibration
from pages import TOP, blocks

import cbsr_qa as qa
from cbsr_qa.calibration.file.hdf5 import write_calibration
from cbsr_qa.config.documents import DocumentKind, open_document

pytest.importorskip("pandas")
pytest.importorskip("xarray")

_TUTORIAL = TOP / "docs" / "tutorials" / "first-sensor-in-a-notebook.md"
_REFERENCE = TOP / "docs" / "reference" / "python.md"


_RECIPE = """
[recipe]
name = "three-locations"
calibrate_phases = ["nine locations"]

[[phases]]
name = "nine locations"
sequence = "location-grid"
locations_mm = [[0.0, 0.0], [30.0, 0.0], [0.0, 30.0]]
initial_rest_s = 60.0

"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder for all pages, with a short recipe: the shipped one with three places and two metrics."""
    folder = tmp_path_factory.mktemp("pages")
    shipped = open_document(DocumentKind.RECIPE, "nine-locations").text
    settings = shipped[shipped.index("[reconstruction]") : shipped.index("[metrics]")]
    limit = '[[limits]]\nmeasurement = "centre_of_mass_error"\nunit = "mm"\nupper = 6.5\n'
    metrics = "[metrics]\narea-overlap = {}\ncentre-of-mass-error = {}\n"
    (folder / "short.toml").write_text(f"{_RECIPE}{settings}{metrics}{limit}")
    return folder


@pytest.fixture(autouse=True)
def _in_the_folder(folder, monkeypatch):
    """Runs take the short recipe, and the run of a sensor that was tested already is the stored one."""
    run = qa.run

    def shortened(*, recipe, serial, **options):
        assert recipe == "nine-locations"
        try:
            return qa.open_database().run(serial)
        except qa.CbsrError:
            return run(recipe="short.toml", serial=serial, **options)

    monkeypatch.chdir(folder)
    monkeypatch.setattr(qa, "run", shortened)
    mpl.use("Agg")


@pytest.mark.rest
def test_the_tutorial_runs_as_printed(capfd):
    namespace = {}
    exec("\n".join(blocks(_TUTORIAL, "python")), namespace)
    printed = capfd.readouterr()
    assert " ± " in printed.out
    assert "press 1 of 3" in printed.out
    assert printed.err == ""
    assert namespace["overlap"].groupby("serial").size().to_dict() == {"N-1": 3, "N-2": 3}
    assert len(namespace["mine"].result.events) == 3
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


def test_a_calibration_by_a_run_is_refused_as_one_from_presses(tmp_path):
    write_calibration(tmp_path / "sensor.h5", force_calibration())
    with pytest.raises(qa.CbsrError, match="load_calibration reads it"):
        qa.PressCalibration.load(tmp_path / "sensor.h5")
