"""What people change, as a user meets it: ``run --why``, ``db changes``, ``verdict override``, and reports."""

import h5py
import pytest
from command import QUICK, cbsr_qa, document, refused, short_recipe

pytestmark = pytest.mark.rest

_OVERRIDE = ("--by", "Zoë Ōtani", "--why", "0.001 mm is a typing error")


@pytest.fixture(scope="module")
def tested(tmp_path_factory):
    """A sensor that passed, and one that failed by a limit nobody gave a reason for; folder and documents."""
    folder = tmp_path_factory.mktemp("changed")
    runs = []
    for serial, upper in (("S-1", "6.5"), ("S-2", "0.001")):
        recipe = short_recipe(folder, metrics=QUICK, **{"upper = 6.5": f"upper = {upper}"})
        files = ("--station", "simulated", "--recipe", recipe, "--serial", serial, "--operator", "Jo")
        runs.append(document(cbsr_qa(folder, "run", *files, "--json", check=False)))
    return folder, runs


def test_a_limit_that_changed_without_a_reason_is_said_and_stored(tested):
    folder, (first, second) = tested
    assert first["changes"] == []
    assert not any("no reason given" in warning for warning in first["warnings"])
    (change,) = second["changes"]
    key = "limits[centre_of_mass_error].upper"
    assert change["differences"] == [{"key": key, "before": "6.5", "after": "0.001"}]
    assert (change["kind"], change["by"], change["why"]) == ("recipe", "Jo", "no reason given")
    assert change["earlier_run"] == first["run"]
    (warning,) = [warning for warning in second["warnings"] if "no reason given" in warning]
    assert f"{key} 6.5 → 0.001" in warning
    assert document(cbsr_qa(folder, "db", "changes", "--json"))["changes"] == [change]
    page = (folder / second["report"]).read_text()
    assert f"{key} 6.5 → 0.001" in page
    assert f"since this type of sensor last passed this recipe (run {first['run']})" in page


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("nothing", "--outcome", "pass", *_OVERRIDE), "there is no run nothing"),
        (("S-2", "--outcome", "pass", *_OVERRIDE), "there is no run S-2"),
        (("RUN", "--outcome", "marginal", *_OVERRIDE), "allowed: pass, fail"),
        (("RUN", "--outcome", "pass", "--by", " ", "--why", "so"), "needs --by"),
        (("RUN", "--outcome", "pass", "--by", "Jo", "--why", ""), "needs --why"),
        (("RUN", "--outcome", "pass", "--by", "Jo"), "why"),
        (("RUN", "--outcome", "pass", "--by", "Jo", "--why", "two\nlines"), "one line"),
    ],
)
def test_an_override_without_run_name_or_reason_is_refused(tested, arguments, said):
    folder, (_, second) = tested
    asked = [second["run"] if word == "RUN" else word for word in arguments]
    assert said in refused(folder, "verdict", "override", *asked)
    assert document(cbsr_qa(folder, "db", "changes", "--json"))["overrides"] == []


def test_an_override_stands_beside_the_verdict_wherever_that_is_shown(tested):
    folder, (_, second) = tested
    run = second["run"]
    made = document(cbsr_qa(folder, "verdict", "override", run, "--outcome", "pass", *_OVERRIDE, "--json"))
    assert (made["verdict"], made["outcome"], made["calibration"]) == ("fail", "pass", None)
    assert "an override does not issue one" in made["note"]
    told = {key: value for key, value in made.items() if key not in ("calibration", "note", "standing_certificates")}

    report = document(cbsr_qa(folder, "report", run, "--json"))
    assert (report["outcome"], report["reason"], report["overrides"]) == ("fail", second["reason"], [told])
    page = (folder / report["report"]).read_text()
    assert "FAIL, overridden to PASS by Zoë Ōtani" in page
    assert "0.001 mm is a typing error" in page
    exported = document(cbsr_qa(folder, "export", run, "--to", "run.h5", "--json"))
    assert exported["overrides"] == [told]
    with h5py.File(folder / "run.h5") as file:
        assert "fail overridden to pass by Zoë Ōtani" in str(dict(file.attrs))
    assert not (folder / "var" / "calibrations" / f"S-2-{run}.h5").exists()

    cbsr_qa(folder, "verdict", "override", run, "--outcome", "fail", "--by", "Jo", "--why", "it is not")
    listed = document(cbsr_qa(folder, "db", "changes", "--json"))["overrides"]
    assert [(one["outcome"], one["by"]) for one in listed] == [("pass", "Zoë Ōtani"), ("fail", "Jo")]
