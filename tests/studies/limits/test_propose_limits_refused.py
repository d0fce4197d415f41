"""``limits propose`` on stored golden lots: which lots, terms and files it refuses, and what it says then."""

from dataclasses import replace

import numpy as np
import pytest
from proposed_lots import lot, replace_value, sensor
from stored_lots import judged, measured

from cbsr_qa.cli.main import run_guarded
from cbsr_qa.domain.plan.limits import Bound
from cbsr_qa.domain.run.states import EndReason


def test_no_lot_or_an_empty_one_is_refused(lot_database, refused, tmp_path):
    refused(lot_database, said=["no golden lot is named", "--batch"])
    refused(lot_database, "--batch", "goldn", said=["'goldn'", "did you mean 'golden'"])
    refused(lot_database, "--recipe", "shrt", said=["did you mean 'short'"])
    refused(lot_database, "--serial", "S-1", said=["of sensor 'S-1'", "did you mean"])
    refused(lot_database, "--batch", "golden", "--since", "2030-01-01", said=["no stored run fits"])
    refused(lot_database, "--serial", "S-01", said=["too few sensors: 1;"])
    refused(lot_database, "--serials", tmp_path / "nowhere.txt", said=["nowhere.txt", "No such file"])
    (tmp_path / "bad.txt").write_text("S-01\nS 02\n")
    refused(lot_database, "--serials", tmp_path / "bad.txt", said=["bad.txt line 2", "'S 02'"])
    (tmp_path / "none.txt").write_text("# nobody\n")
    refused(lot_database, "--serials", tmp_path / "none.txt", said=["names no sensor"])


def test_what_is_not_measured_is_refused_with_the_nearest_name(lot_database, refused):
    chosen = ("--batch", "golden", "--measurement")
    refused(lot_database, *chosen, "drit", said=["'drit'", "did you mean 'drift'", "noise_floor"])


@pytest.mark.parametrize(
    ("option", "value", "said"),
    [
        ("--coverage", 100, "50 to 99.99"),
        ("--confidence", 99.95, "50 to 99.9 %"),
        ("--coverage", "nan", "50 to 99.99"),
        ("--guard-factor", -1, "0 to 10"),
        ("--distribution", "lognormal", "did you mean 'log-normal'"),
        ("--limits-version", "a b", "letters, digits"),
        ("--since", "yesterday", "not a date like 2027-03-31"),
    ],
)
def test_terms_out_of_range_are_refused(lot_database, refused, option, value, said):
    refused(lot_database, "--batch", "golden", option, value, said=[said])


@pytest.mark.rest
def test_runs_that_are_not_good_are_refused_unless_asked_for(database, refused, document):
    failed = ("S-6", judged(measured(np.random.default_rng(6), np.array([0, 12.0, 0]))), {})
    aborted = ("S-7", (), {"end": EndReason.ABORTED})
    path = database(*lot(), failed, aborted)
    refused(path, "--batch", "golden", said=["2 of the 7 runs", "S-6 (fail: drift is", "S-7 (aborted", "--without"])
    found = document(path, "--batch", "golden", "--include-failed", "--measurement", "centre_of_mass_error")
    assert len(found["lot"]["not_good"]) == 2
    assert list(found["lot"]["sensors"]) == [f"S-{k}" for k in range(1, 7)]  # the aborted one measured nothing
    without = document(path, "--batch", "golden", "--without", "S-6", "--without", "S-7")
    assert without["lot"]["not_good"] == []


@pytest.mark.rest
def test_mixed_software_and_recipes_are_refused_by_name(database, refused, document):
    newer = ("S-6", sensor(6), {"software": [("cbsr-qa", "0.2.0"), ("numpy", "2.0")]})
    path = database(*lot(), newer)
    refused(path, "--batch", "golden", said=["software versions: cbsr-qa 0.1.0 (S-1, S-2", "cbsr-qa 0.2.0 (S-6)"])
    found = document(path, "--batch", "golden", "--allow-mixed")
    assert "0.2.0" in found["lot"]["mixed"][0]
    other = ("S-8", sensor(8), {"tables": {"analysis": {"steady_frames": 8}}, "batch": "other"})
    path = database(other, *[("S-9", sensor(9), {"batch": "other"}), ("S-10", sensor(10), {"batch": "other"})])
    refused(path, "--batch", "other", said=["recipes: short", "(S-8)", "(S-9, S-10)", "--allow-mixed"])


@pytest.mark.rest
def test_other_limits_or_another_seed_make_no_other_recipe(database, document):
    relimited = [(f"S-{k}", sensor(k), {"limits": [{"upper": k}], "day": k}) for k in range(1, 6)]
    assert document(database(*relimited), "--batch", "golden")["lot"]["mixed"] == []


def test_values_that_make_no_lot_are_refused_by_name(database, refused):
    def path(*changed):
        return database(*[("T-1", sensor(1), {}), ("T-2", sensor(2), {})], *changed)

    name = ("--batch", "golden", "--measurement", "drift")
    micro = tuple(replace(m, unit="ppm/min", limit=None) if m.name == "drift" else m for m in sensor(3))
    refused(path(("T-3", micro, {})), *name, said=["drift is in %/min (T-1) and ppm/min (T-3)"])
    nothing = replace_value(sensor(4), "drift", None, how="the sheet never rested")
    first = path(("T-3", nothing, {"batch": "b4"}))
    chosen = ("--serial", "T-1", "--serial", "T-2", "--serial", "T-4", "--measurement", "drift")
    database(("T-4", nothing, {}))
    refused(first, *chosen, "--include-failed", said=["T-4 has no value in 1 of 1: the sheet never rested"])


def test_missing_and_censored_values_are_refused_by_name(database, refused):
    fewer = sensor(3, locations=8)
    path = database(("U-1", sensor(1), {}), ("U-2", sensor(2), {}), ("U-3", fewer, {}))
    place = ("--batch", "golden", "--measurement", "centre_of_mass_error")
    refused(path, *place, said=["8 (such as U-3) and 9 (such as U-"])
    censored = replace_value(sensor(5), "drift", 0.2, bound=Bound.LOWER, limit=None)
    database(("U-5", censored, {}))
    chosen = [word for name in ("U-1", "U-2", "U-5") for word in ("--serial", name)]
    refused(path, *chosen, "--measurement", "drift", "--include-failed", said=["of U-5 only lower bounds"])


def test_a_file_that_exists_is_not_written_over(lot_database, refused, tmp_path):
    file = tmp_path / "limits.toml"
    file.write_text("mine")
    refused(lot_database, "--batch", "golden", "--output", file, said=["exists already"])
    assert file.read_text() == "mine"
    refused(lot_database, "--batch", "golden", "--output", tmp_path / "page.html", said=["not named as a TOML file"])
    missing = tmp_path / "no folder" / "limits.toml"
    refused(lot_database, "--batch", "golden", "--output", missing, said=["cannot be written"])


def test_nothing_is_written_where_nothing_is_proposed(lot_database, refused, tmp_path):
    file = tmp_path / "limits.toml"
    refused(lot_database, "--serial", "S-01", "--serial", "S-02", "--output", file, said=["too few sensors: 2;"])
    assert not file.exists()


def test_a_database_without_runs_or_none_at_all_is_refused(tmp_path, database, refused):
    refused(database(), "--batch", "golden", said=["no stored run is of batch", "cbsr-qa db status"])
    refused(tmp_path / "nowhere.db", "--batch", "golden", said=["nowhere.db"])


@pytest.mark.parametrize(
    ("option", "value", "said"),
    [("--serials", "/dev/zero", "it is a device, not a file"), ("--output", "x" * 300, "File name too long")],
)
def test_what_is_no_file_is_refused_and_not_read_for_ever(option, value, said, capsys):
    assert run_guarded(["limits", "propose", "--serial", "S-1", option, value]) == 2
    assert said in capsys.readouterr().err
