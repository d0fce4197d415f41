"""``cbsr-qa run`` as a user meets it: determinism, refusals, exit codes, what is written and where."""

import json
import sqlite3
import subprocess
import sys

import h5py
import pytest
from command import QUICK, cbsr_qa, document, refused, short_recipe
from made_once import copy_of, made_once

from cbsr_qa.config.documents import DocumentKind, open_document
from cbsr_qa.config.loader import load_recipe
from cbsr_qa.plugin.discovery import discover
from cbsr_qa.plugin.hooks import Kind


def _run(folder, *more, check=True, serial="S-1", fresh=False, metrics=None, **environment):
    files = ["--station", "simulated", "--recipe", short_recipe(folder, metrics=metrics)]
    return cbsr_qa(
        folder, "run", *files, "--serial", serial, "--json", *more, check=check, fresh=fresh, **environment
    )


def _stored(folder):
    """Every stored number of the latest run: frames, samples, presses, measurements."""
    with sqlite3.connect(folder / "var" / "cbsr-qa.db") as database:
        run = database.execute("select max(run) from runs").fetchone()
        queries = [
            "select phase, block, sha256 from frame_blocks where run = ? order by 1, 2",
            "select phase, block, channel, sha256 from sample_blocks where run = ? order by 1, 2",
            "select phase, load_index, label, x_mm, y_mm, press_start_s, rest_end_s from loads where run = ?",
            "select name, qualifier, location, value, uncertainty, outcome from measurements natural join analyses"
            " where run = ? order by analysis, number",
        ]
        return [database.execute(query, run).fetchall() for query in queries]


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """A finished run with seed 11, of one thread."""
    one_thread = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}

    def make(folder):
        done = _run(folder, "--seed", "11", fresh=True, **one_thread)
        folder.with_suffix(".json").write_text(done.stdout)

    folder = copy_of("finished", make, tmp_path_factory.mktemp("finished"))
    return folder, json.loads(made_once("finished", make).with_suffix(".json").read_text())


@pytest.fixture(scope="module")
def twice():
    """A sensor that was tested twice without a seed."""

    def make(folder):
        runs = [document(_run(folder, metrics=QUICK)) for _ in range(2)]
        (folder / "runs.json").write_text(json.dumps(runs))

    folder = made_once("tested twice", make)
    return folder, json.loads((folder / "runs.json").read_text())


def test_the_document_says_what_was_promised(finished):
    folder, run = finished
    assert {"run", "end", "outcome", "reason", "report", "calibration", "measurements"} <= set(run)
    assert run["end"] == "finished"
    assert run["outcome"] in ("pass", "marginal", "fail")
    for key in ("station_s", "compute_s"):
        assert run[key] > 0
    with sqlite3.connect(folder / "var" / "cbsr-qa.db") as database:
        (stages,) = database.execute("SELECT compute_s FROM analyses WHERE run = ?", (run["run"],)).fetchone()
    assert [name for name, _ in json.loads(stages)] == ["reading the run back", "imaging", "metrics"]  # no station
    for measurement in run["measurements"]:
        assert {"name", "value", "unit", "lower", "upper", "outcome"} <= set(measurement)
    assert (folder / run["report"]).is_file()
    assert (folder / run["calibration"]).is_file()
    assert [path.name for path in folder.iterdir() if path.name != "short.toml"] == ["var"]


@pytest.mark.rest
def test_the_same_seed_stores_identical_numbers_whatever_the_threads(finished, tmp_path):
    _run(tmp_path, "--seed", "11", fresh=True, OMP_NUM_THREADS="2", OPENBLAS_NUM_THREADS="2")
    assert _stored(tmp_path) == _stored(finished[0])


@pytest.mark.rest
def test_another_seed_stores_other_frames(finished, tmp_path):
    _run(tmp_path, "--seed", "12", metrics=QUICK)
    assert _stored(tmp_path)[0] != _stored(finished[0])[0]


@pytest.mark.rest
def test_without_a_seed_a_second_try_of_a_sensor_is_not_the_first_again(twice):
    first, second = twice[1]
    assert first["seed"] != second["seed"]
    assert first["run"] < second["run"]
    assert [run["sensor_history"]["try"] for run in twice[1]] == [1, 2]
    (earlier,) = second["sensor_history"]["earlier_runs"]
    assert (earlier["run"], earlier["outcome"]) == (first["run"], first["outcome"])


@pytest.mark.rest
def test_the_calibration_is_in_the_database_and_the_next_supersedes_it(twice):
    with sqlite3.connect(twice[0] / "var" / "cbsr-qa.db") as database:
        rows = database.execute("select calibration from calibrations order by 1").fetchall()
        valid = database.execute("select calibration from v_calibrations").fetchall()
        (baselines,) = database.execute("select count(*) from calibration_baselines where value > 0").fetchone()
    assert (len(rows), valid) == (2, rows[1:])
    assert baselines == 2


@pytest.mark.rest
def test_report_renders_the_same_bytes_again(finished):
    folder, run = finished
    before = (folder / run["report"]).read_bytes()
    again = document(cbsr_qa(folder, "report", "S-1", "--json"))
    assert (folder / again["report"]).read_bytes() == before


def test_a_calibrations_file_that_was_changed_in_the_database_is_refused_by_report(finished, tmp_path):
    path = tmp_path / "copy.db"
    with sqlite3.connect(finished[0] / "var" / "cbsr-qa.db") as source, sqlite3.connect(path) as database:
        source.backup(database)
        database.execute("update calibrations set file = zeroblob(length(file))")
    assert "is not what was stored" in refused(tmp_path, "report", "S-1", "--database", path)


@pytest.mark.rest
def test_weights_from_the_measured_noise_reach_report_database_and_calibration_file(finished, tmp_path):
    recipe = short_recipe(tmp_path, **{'weighting = "equal"': 'weighting = "measured"'})
    files = ["--station", "simulated", "--recipe", recipe, "--serial", "S-1", "--json", "--seed", "11"]
    run = document(cbsr_qa(tmp_path, "run", *files))
    with sqlite3.connect(tmp_path / "var" / "cbsr-qa.db") as database:
        stored = database.execute("select noise_weighting, weight_ratio from analyses").fetchone()
    with sqlite3.connect(finished[0] / "var" / "cbsr-qa.db") as database:
        assert set(database.execute("select noise_weighting, weight_ratio from analyses")) == {("equal", 1.0)}
    with h5py.File(tmp_path / run["calibration"]) as file:
        variance = file["reconstruction/noise_variance"][()]
        assert file["reconstruction/regularisation_name"].asstr()[()] == "λ"
        assert file["reconstruction/regularisation_criterion"].asstr()[()] == "noise-figure"
    assert stored == ("measured", pytest.approx(variance.max() / variance.min(), rel=1e-12))
    imaged = run["reconstruction"]
    assert (imaged["noise_weighting"], imaged["weight_ratio"]) == ("measured", pytest.approx(stored[1]))
    assert (imaged["parameter"]["name"], imaged["parameter"]["criterion"]) == ("λ", "noise-figure")
    before = (tmp_path / run["report"]).read_bytes()
    assert b"measured: by the variance of each reading over 30 unloaded frames" in before
    (tmp_path / run["calibration"]).unlink()
    again = document(cbsr_qa(tmp_path, "report", "S-1", "--json"))
    assert (tmp_path / again["report"]).read_bytes() == before
    sound = document(cbsr_qa(tmp_path, "calibration", "verify", run["calibration"], "--json"))
    assert sound["sound"] is True


@pytest.mark.rest
def test_an_exported_run_is_read_back_with_its_presses(finished):
    folder, run = finished
    exported = document(cbsr_qa(folder, "export", run["run"], "--to", "run.h5", "--json"))
    (folder / "run.h5").rename(folder / "var" / "run.h5")
    analysed = document(cbsr_qa(folder, "analyse", "var/run.h5", "--json"))
    assert analysed["recording"]["frames"] == exported["frames"]
    assert analysed["recording"]["force_recorded"] is True
    assert analysed["recording"]["simulated"] == run["simulated"]
    assert "This report does not describe a real sensor" in (folder / analysed["report"]).read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--station", "simulatd", "--recipe", "nine-locations", "--serial", "A"], "did you mean 'simulated'"),
        (["--station", "simulated", "--recipe", "no/such.toml", "--serial", "A"], "no/such.toml"),
        (["--station", "simulated", "--recipe", "nine-locations", "--serial", ""], "serial number"),
        (["--station", "simulated", "--recipe", "nine-locations", "--serial", "../../x"], "'/' is not allowed"),
    ],
)
def test_refused_input_is_one_clear_message_and_nothing_is_written(tmp_path, arguments, said):
    message = refused(tmp_path, "run", *arguments)
    assert said in message
    assert len(message) < 1000
    assert list(tmp_path.iterdir()) == []


def test_a_malformed_recipe_names_file_and_line(tmp_path):
    (tmp_path / "bad.toml").write_text('[recipe]\nname = "x"\nphases = = 3\n')
    said = refused(tmp_path, "run", "--station", "simulated", "--recipe", "bad.toml", "--serial", "A")
    assert "bad.toml" in said
    assert "line 3" in said


@pytest.mark.rest
def test_a_limit_that_is_not_met_fails_the_run_with_exit_code_1(tmp_path):
    recipe = short_recipe(tmp_path, metrics=QUICK, **{"upper = 6.5": "upper = 0.001"})
    done = cbsr_qa(
        tmp_path, "run", "--station", "simulated", "--recipe", recipe, "--serial", "A", "--json", check=False
    )
    run = document(done)
    assert (done.returncode, run["outcome"], run["calibration"]) == (1, "fail", None)
    assert "centre of mass error" in run["reason"]
    assert run["calibration_why"]


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({'measurement = "centre_of_mass_error"': 'measurement = "centre_of_mass_eror"'}, "did you mean 'centre_of"),
        ({"noise_floor_frames = 8": "noise_floor_frames = 50"}, "takes 30 unloaded frames"),
        ({'sequence = "noise-figure"': 'sequence = "noise-figur"'}, "did you mean 'noise-figure'"),
        ({"strain_percent = 20.0": "strain_percent = 36.0"}, "36"),
        *(
            pytest.param(*other, marks=pytest.mark.rest)
            for other in (
                ({'unit = "mm"': 'unit = "µm"'}, "unit is 'µm'; it must be 'mm'"),
                ({"noise_figure = 1.0": "noise_figure = 1e6"}, "allows"),
                (
                    {
                        '"gauss-newton-noser"\nnoise_figure = 1.0': '"linear-back-projection"\n#',
                        "exponent = 0.25": "#",
                        'weighting = "equal"': 'weighting = "measured"',
                    },
                    "'linear-back-projection' weights all readings equally",
                ),
            )
        ),
    ],
)
def test_a_recipe_that_cannot_be_run_or_analysed_is_refused_before_anything_moves(tmp_path, change, said):
    recipe = short_recipe(tmp_path, **change)
    for more in ([], ["--dry-run"]):
        files = ["--station", "simulated", "--recipe", recipe, "--serial", "A", "--json", *more]
        done = cbsr_qa(tmp_path, "run", *files, check=False)
        assert done.returncode == 2
        told = document(done)["refused"]
        assert said in told["reason"] + told["remedy"]
    assert not (tmp_path / "var").exists()


def test_every_metric_of_the_shipped_recipe_measures_what_it_declares(finished):
    plugins = discover()
    declared = {}
    for choice in load_recipe("nine-locations").value.metrics:
        declared |= plugins.factory(Kind.METRIC, choice.name)().measures
    measured = {m["name"]: m["unit"] for m in finished[1]["measurements"]}
    assert measured == declared


@pytest.mark.rest
def test_an_overdue_calibration_is_a_warning(tmp_path):
    station = open_document(DocumentKind.STATION, "simulated").text + "calibration_due = 2020-01-01\n"
    (tmp_path / "old.toml").write_text(station)
    recipe = short_recipe(tmp_path, metrics=QUICK)
    files = ["--station", "old.toml", "--recipe", recipe, "--serial", "A", "--seed", "11"]
    run = document(cbsr_qa(tmp_path, "run", *files, "--json"))
    assert any("was due on 2020-01-01" in warning for warning in run["warnings"])


@pytest.mark.rest
def test_a_calibration_file_that_could_not_be_written_costs_no_verdict_and_is_written_again(tmp_path):
    blocked = tmp_path / "var" / "calibrations"
    # A folder that goes away in the middle of a run: a full disk, as far as can be had without one.
    script = f"""
import shutil, sys
from pathlib import Path
import cbsr_qa.app.run.conclusion as conclusion

real = conclusion.evaluate_run
def evaluate_run(*arguments, **options):
    shutil.rmtree({str(blocked)!r})
    Path({str(blocked)!r}).write_text("in the way")
    return real(*arguments, **options)
conclusion.evaluate_run = evaluate_run
from cbsr_qa.cli.main import run_guarded
sys.exit(run_guarded(sys.argv[1:]))
"""
    recipe = short_recipe(tmp_path, metrics=QUICK)
    files = ["--station", "simulated", "--recipe", recipe, "--serial", "A", "--seed", "11", "--json"]
    done = subprocess.run(
        [sys.executable, "-c", script, "run", *files], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    run = document(done)
    assert (done.returncode, run["end"], run["outcome"], run["calibration"]) == (3, "finished", "pass", None)
    assert any("could not be written" in warning for warning in run["warnings"])
    assert (tmp_path / run["report"]).is_file()

    blocked.unlink()
    cbsr_qa(tmp_path, "report", "A")
    (written,) = blocked.glob("*.h5")
    cbsr_qa(tmp_path, "calibration", "verify", str(written))


def test_a_dry_run_writes_nothing(tmp_path):
    arguments = ["--station", "simulated", "--recipe", "nine-locations", "--serial", "A", "--dry-run"]
    said = document(cbsr_qa(tmp_path, "run", *arguments, "--json"))
    assert said["loads"] == 23
    assert said["violations"] == []
    assert list(tmp_path.iterdir()) == []


def test_version_imports_nothing_heavy(tmp_path):
    script = (
        "import sys; from cbsr_qa.cli.main import run_guarded; run_guarded(['--version']);"
        "print(sorted({'numpy', 'scipy', 'sqlalchemy', 'matplotlib', 'cbsr_qa_plugins', 'rich'} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True, cwd=tmp_path)
    assert done.stdout.splitlines()[-1] == "[]"
