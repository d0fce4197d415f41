"""Stored runs analysed again: what is kept, compared and adopted. Workers are made up: none images anything."""

import shutil
import sqlite3
from concurrent.futures import Executor, Future
from contextlib import closing, nullcontext
from dataclasses import replace

import pytest
from stored_lots import store_run

from cbsr_qa.app.changes import list_changes
from cbsr_qa.app.reanalyse.reanalysis import phase_difference, reanalyse
from cbsr_qa.app.reanalyse.report import reanalysis_outcome
from cbsr_qa.app.reanalyse.request import ReanalyseRequest
from cbsr_qa.app.reanalyse.work import Worked
from cbsr_qa.app.reanalyse.workers import Workers
from cbsr_qa.config.documents import DocumentKind, open_document
from cbsr_qa.config.loader import load_recipe
from cbsr_qa.config.text import toml_document
from cbsr_qa.domain.errors import ConfigError, RefusedError
from cbsr_qa.domain.plan.limits import Limit, Outcome
from cbsr_qa.domain.results.fleet import RunSelection
from cbsr_qa.domain.results.measurement import Measurement, decide
from cbsr_qa.domain.run.states import EndReason
from cbsr_qa.report.document import json_document
from cbsr_qa.report.terminal import terminal_lines
from cbsr_qa.store.opening import open_store
from cbsr_qa.store.results.reanalyses import Reanalysis

RECIPE = {**open_document(DocumentKind.RECIPE, "nine-locations").data, "failure_codes": {}}
LIMIT = Limit("centre_of_mass_error", "mm", None, 5.0)
EVERY = RunSelection()


def values(error, noise=0.5):
    return (
        Measurement("centre_of_mass_error", error, "mm", phase="nine locations", location="L0").judge(LIMIT),
        Measurement("noise", noise, "1"),
    )


class Inline(Executor):
    def submit(self, work, job):
        future = Future()
        future.set_result(work(job))
        return future


class Made:
    """Workers that find ``error_mm`` more, and count what they are asked."""

    def __init__(self, error_mm=0.0, **refusals):
        self.error_mm, self.refusals, self.jobs = error_mm, refusals, []

    def __call__(self):
        return nullcontext(Workers(lambda: nullcontext(Inline()), 1, self.work))

    def work(self, job):
        self.jobs.append(job)
        if why := self.refusals.get(job.run):
            return why if isinstance(why, Worked) else Worked(None, why)
        with open_store(job.database, create=False) as store:
            before = store.analyses.load(job.run)[-1].measurements
        new = values(before[0].value + self.error_mm)
        facts = (job.recipe, job.software, decide(new), new, ("a new warning",), "equal", 1.0, (("imaging", 1.0),))
        return Worked(Reanalysis(job.run, job.key_sha256, *facts), peak_mb=123.0)


@pytest.fixture(scope="module")
def filled(tmp_path_factory):
    """Three runs: 4.0 and 4.5 mm pass, 6.0 mm fails; and one that was aborted."""
    path = tmp_path_factory.mktemp("reanalysed") / "runs.db"
    with open_store(f"sqlite:///{path}") as store:
        for number, error in enumerate((4.0, 4.5, 6.0)):
            store_run(store, f"S-{number}", values(error), recipe="nine-locations", tables=RECIPE, day=number)
        store_run(store, "S-9", (), recipe="nine-locations", tables=RECIPE, end=EndReason.ABORTED)
    return path


@pytest.fixture
def database(filled, tmp_path):
    """Return a copy of the database to change."""
    return str(shutil.copy(filled, tmp_path))


def again(database, made, **changes):
    request = ReanalyseRequest(EVERY, database=database, **changes)
    return reanalyse(request, begin=made)


def verdicts(database):
    with open_store(database_url(database), create=False) as store:
        return [(run.serial, run.outcome) for run in store.fleet.read_lines() if run.finished]


def database_url(database):
    return f"sqlite:///{database}"


BEFORE = [("S-0", Outcome.PASS), ("S-1", Outcome.PASS), ("S-2", Outcome.FAIL)]


def test_changes_and_flips_are_shown_and_no_verdict_changes(database):
    done = again(database, Made(0.75))
    assert (done.selected, done.computed, done.reused, done.adopted, done.unchanged) == (4, 3, 0, 0, 0)
    error, noise = done.values
    assert (error.name, error.phase, error.unit, error.values, error.changed) == (
        "centre_of_mass_error",
        "nine locations",
        "mm",
        3,
        3,
    )
    assert (error.median, error.largest) == (0.75, 0.75)
    assert (noise.values, noise.changed, noise.largest, noise.run) == (3, 0, 0.0, "")
    (flip,) = done.flips
    assert (flip.serial, flip.was, flip.now) == ("S-1", Outcome.PASS, Outcome.FAIL)
    (aborted,) = done.not_analysed
    assert (aborted.serial, aborted.why) == ("S-9", "it has not finished (aborted)")
    assert done.new_warnings == {"a new warning": 3}
    assert verdicts(database) == BEFORE
    shown = "\n".join(terminal_lines(*((out := reanalysis_outcome(done)).page, out.sections)))
    assert out.exit_code == 0
    for words in ("1 verdict differs", "S-1", "centre of mass error", "0.750", "--adopt --by NAME", "123 MB"):
        assert words in shown, words
    assert json_document(done)["flips"][0]["serial"] == "S-1"


def test_a_repeat_computes_nothing_and_says_so(database):
    first = again(database, Made(0.75))
    second = again(database, made := Made(7.0))
    assert made.jobs == []
    assert (second.computed, second.reused) == (0, 3)
    assert (second.values, second.flips) == (first.values, first.flips)
    assert "nothing was computed: 3 of 3" in reanalysis_outcome(second).page.banner.reason
    third = again(database, made := Made(7.0), fresh=True)
    assert (len(made.jobs), third.values[0].largest) == (3, 7.0)


def limited(tmp_path, upper, name="limited.toml", **tables):
    """Return the file of the recipe with one limit, of an error of place."""
    limits = [{"measurement": "centre_of_mass_error", "unit": "mm", "upper": upper, "phase": "nine locations"}]
    text = toml_document({**RECIPE, "limits": limits, **tables})
    return str((tmp_path / name).write_text(text) and tmp_path / name)


def test_where_only_limits_differ_nothing_is_imaged_again(database, tmp_path, monkeypatch):
    monkeypatch.setattr("cbsr_qa.app.reanalyse.reanalysis._Session.check", lambda *_: None)  # of a station
    by_limit = again(database, made := Made(0.75), recipe=limited(tmp_path, 4.2))
    assert (len(made.jobs), by_limit.computed, by_limit.judged) == (3, 3, 0)  # the analyses are of other software
    stricter = again(database, made := Made(7.0), recipe=limited(tmp_path, 4.8))
    assert (made.jobs, stricter.computed, stricter.judged, stricter.reused) == ([], 0, 3, 0)
    assert stricter.values == by_limit.values
    assert [(flip.serial, flip.now) for flip in stricter.flips] == [("S-1", Outcome.FAIL)]
    assert "3 judged by other limits" in reanalysis_outcome(stricter).page.banner.reason
    assert again(database, made, recipe=limited(tmp_path, 4.8)).reused == 3
    again(database, made := Made(7.0), recipe=limited(tmp_path, 4.9), fresh=True)
    assert len(made.jobs) == 3
    other = {"analysis": {**RECIPE["analysis"], "noise_floor_frames": 9}}
    again(database, made := Made(7.0), recipe=limited(tmp_path, 4.8, **other))
    assert len(made.jobs) == 3


def test_analyses_of_the_same_software_are_judged_too_and_a_repeat_by_the_own_recipe_is_not(
    database, tmp_path, monkeypatch
):
    with open_store(database_url(database), create=False) as store:
        software = store.analyses.load(store.fleet.read_lines()[0].run)[0].software
    monkeypatch.setattr("cbsr_qa.app.reanalyse.reanalysis.software_versions", lambda plugins: software)
    monkeypatch.setattr("cbsr_qa.app.reanalyse.reanalysis._Session.check", lambda *_: None)
    done = again(database, made := Made(7.0), recipe=limited(tmp_path, 4.2))
    assert (made.jobs, done.judged) == ([], 3)
    assert [(flip.serial, flip.was, flip.now) for flip in done.flips] == [("S-1", Outcome.PASS, Outcome.FAIL)]
    assert all(value.changed == 0 for value in done.values)
    again(database, made := Made())
    assert len(made.jobs) == 3


def test_other_software_is_computed_again(database, monkeypatch):
    again(database, Made(0.75))
    monkeypatch.setattr("cbsr_qa.app.reanalyse.reanalysis.software_versions", lambda plugins: (("cbsr-qa", "9"),))
    assert again(database, Made(0.75)).computed == 3


def test_adopted_results_are_the_valid_analyses_and_the_earlier_ones_stay(database):
    again(database, Made(0.75))
    done = again(database, made := Made(), adopt=True, by="Ada", why="corrected gain")
    assert (made.jobs, done.adopted) == ([], 3)
    assert verdicts(database) == [("S-0", Outcome.PASS), ("S-1", Outcome.FAIL), ("S-2", Outcome.FAIL)]
    with open_store(database_url(database), create=False) as store:
        for run in store.fleet.read_lines():
            if run.finished:
                now, before = store.analyses.load(run.run)
                assert now.measurements[0].value == before.measurements[0].value + 0.75
                assert (now.adoption.operator, now.adoption.why, before.adoption) == ("Ada", "corrected gain", None)
                assert "that issues no calibration" in now.calibration_why
                store.runs.load(run.run)  # the chain covers it
    listed = list_changes(database)
    assert listed.page.banner.headline == "changes of 3 analyses"
    (adopted,) = listed.result.adoptions
    assert (adopted.operator, adopted.why, adopted.runs) == ("Ada", "corrected gain", 3)
    repeated = again(database, Made(), adopt=True, by="Ada", why="corrected gain")
    assert (repeated.adopted, repeated.flips, repeated.unchanged) == (0, (), 3)


def test_a_run_whose_verdict_was_overridden_is_not_adopted(database):
    with open_store(database_url(database), create=False) as store:
        run = store.runs.resolve("S-2")
        store.changes.override_verdict(run, Outcome.PASS, operator="Zoë", why="seen")
    done = again(database, Made(-2.0), adopt=True, by="Ada", why="so")
    assert (done.adopted, [one.serial for one in done.left_overridden]) == (2, ["S-2"])
    assert [flip.overridden_to for flip in done.flips] == [Outcome.PASS]


def test_a_run_that_cannot_be_analysed_is_named_and_nothing_of_it_is_stored(database):
    with open_store(database_url(database), create=False) as store:
        run = store.runs.resolve("S-1")
    done = again(database, Made(0.75, **{run: "the frames cannot be imaged"}))
    assert ("S-1", "the frames cannot be imaged") in [(one.serial, one.why) for one in done.not_analysed]
    assert done.computed == 2
    assert again(database, made := Made(0.75)).computed == 1
    assert [job.run for job in made.jobs] == [run]


def test_a_worker_with_other_software_stops_the_work_and_keeps_what_is_stored(database):
    with open_store(database_url(database), create=False) as store:
        run = store.runs.resolve("S-1")
    made = Made(0.75, **{run: Worked(None, differing="numpy 1 in place of 2", worker="b, process 1")})
    with pytest.raises(RefusedError, match=r"worker b, process 1 has other software .*numpy 1"):
        again(database, made)
    assert again(database, Made(0.75)).reused == 1


def test_an_altered_run_is_named(database):
    again(database, Made(0.75))
    with closing(sqlite3.connect(database)) as connection, connection:
        connection.execute("update measurements set value = 1 where number = 0 and value = 4.0")
    done = again(database, Made())
    assert "was changed" in next(one.why for one in done.not_analysed if one.serial == "S-0")
    assert len(done.values) == 2


def test_runs_of_another_plan_are_named_with_the_phase_that_differs(database, tmp_path):
    text = open_document(DocumentKind.RECIPE, "nine-locations").text
    recipe = tmp_path / "other.toml"
    recipe.write_text(text.replace("frames = 30", "frames = 31"))
    done = again(database, made := Made(), recipe=str(recipe))
    assert made.jobs == []
    assert [(one.serial, one.why) for one in done.other_plan] == [
        (f"S-{n}", "phase 'noise figure' ran with frames = 30; the recipe has frames = 31") for n in range(3)
    ]
    assert reanalysis_outcome(done).exit_code == 3


def test_phases_are_compared_by_name_sequence_and_options():
    phases = load_recipe("nine-locations").value.phases
    assert phase_difference(phases, phases) == ""
    assert "the recipe's are noise figure" in phase_difference(phases, phases[:1])
    other = (replace(phases[0], sequence="campaign"), *phases[1:])
    assert phase_difference(phases, other) == "phase 'noise figure' ran noise-figure; the recipe has campaign"


@pytest.mark.parametrize(
    ("changes", "kind", "said"),
    [
        ({"workers": 0}, RefusedError, "--workers 0"),
        ({"workers": 1, "scheduler": "tcp://a:1"}, RefusedError, "--workers with --scheduler"),
        ({"adopt": True, "why": "so"}, ConfigError, "--adopt needs --by"),
        ({"adopt": True, "by": "Ada"}, ConfigError, "--adopt needs --why"),
        ({"by": "Ada"}, RefusedError, "--by and --why"),
    ],
)
def test_options_that_do_not_fit_are_refused(changes, kind, said):
    with pytest.raises(kind, match=said):
        again("nowhere.db", Made(), **changes)


@pytest.mark.parametrize(
    ("selection", "said"),
    [
        (RunSelection(batch="x"), "no stored run is of batch 'x'"),
        (RunSelection(after="z"), "no stored run is selected"),
    ],
)
def test_no_run_is_refused(database, selection, said):
    with pytest.raises(RefusedError, match=said):
        reanalyse(ReanalyseRequest(selection, database=database), begin=Made())


@pytest.mark.postgres
def test_results_are_kept_on_postgresql_too(postgres_database):
    with open_store(postgres_database) as store:
        store_run(store, "S-1", values(4.5), recipe="nine-locations", tables=RECIPE)
    again(postgres_database, Made(0.75))
    done = again(postgres_database, Made(), adopt=True, by="Ada", why="so")
    assert (done.reused, done.adopted, done.flips[0].now) == (1, 1, Outcome.FAIL)
    with open_store(postgres_database) as store:
        store.runs.load(store.runs.resolve("S-1"))
        assert store.analyses.load(store.runs.resolve("S-1"))[0].measurements == values(5.25)
