"""``reproduce paper`` on figures made by hand: its rows, its document, its page and its words."""

import json
import os
import pickle
import re
import shlex
import signal
from dataclasses import replace
from pathlib import Path

import pytest

from cbsr_qa.cli.main import run_guarded
from cbsr_qa.domain.errors import NotReproducedError
from cbsr_qa.report.document import json_document
from cbsr_qa.report.render import render_sections
from cbsr_qa.studies.reproduce import reproduce, runs as reproduce_runs
from cbsr_qa.studies.reproduce.compare import Ours, Rule, ValueOrigin
from cbsr_qa.studies.reproduce.report import reproduction_outcome
from cbsr_qa.studies.reproduce.reproduce import read_published, reproduction
from cbsr_qa.studies.reproduce.runs import all_jobs, configuration_of, reproduction_error
from cbsr_qa.studies.reproduce.values import ForcePress, SettlingOf, SheetValues, StripValues

_KEYS = ["table1", "table2", "table3", "table4", "table5", "tableF6", "settling", "force"]


def _sheet(paper, sheet, percent):
    """A sheet that gives back what the paper prints."""
    material = next(row for row in paper["table1_material"] if row["wt_percent"] == percent)
    key, column = str(percent), {8: 3, 9: 4}[percent]

    def ours(value, spread=0.0):
        return Ours(sheet, value, spread, "by hand", 18)

    def spatial(rows):
        return tuple(ours(*row) for row in rows)

    masks, places = paper["table3_8wt_20pct_by_threshold"], paper["table4_8wt_20pct_85"]
    errors, deviations = (paper[name]["rows"] for name in ("table5_random_E_CoM_mm", "tableF6_random_SD"))
    spread = paper["force_error_sd_N_at_L0"][key]
    signs = [1, -1] * 9
    return SheetValues(
        sheet=sheet,
        resistance=ours(*material["R_int_kohm"]),
        modulus=ours(material["E_kPa"]),
        noise_figure=ours(*paper["table2_noise"][key]["NF"]),
        noise_floor=ours(paper["relative_noise_floor"][key]),
        noise=ours(1e-3),
        by_mask=tuple((float(p), spatial(masks[p])) for p in ("0.25", "0.50", "0.75", "0.85")),
        by_place=tuple((f"L{k}", spatial(places[f"L{k}"])) for k in range(9)),
        random=tuple((ours(*a[column]), ours(*b[column])) for a, b in zip(errors, deviations, strict=True)),
        size_ratio=tuple((p, 1.0) for p in (0.25, 0.5, 0.75, 0.85)),
        settlings=tuple(SettlingOf(0.2, loading, ours(30.0, 1.0)) for loading in (True, False)),
        presses=tuple(ForcePress("L0", 3.0, 3.0 + sign * spread) for sign in signs),
        stress_slope_per_kPa=paper["gauge_factor"][key] / material["E_kPa"],
        head_mm2=132.7,
        station_s=60.0,
        compute_s=1.0,
    )


def _modulus(paper, percent):
    return next(row["E_kPa"] for row in paper["table1_material"] if row["wt_percent"] == percent)


def _figures(paper, change=lambda sheet: sheet):
    strip = {
        percent: StripValues(
            Ours("strip", paper["gauge_factor"][str(percent)], 0.001), Ours("strip", 0.1, 0.001),
            Ours("strip", _modulus(paper, percent), 0.1),
            (SettlingOf(None, True, Ours("strip", 30.0, 1.0)),), 60.0, 1.0,
        )
        for percent in (8, 9)
    }  # fmt: skip
    return {
        job: strip[job.percent] if job.sheet == "strip" else change(_sheet(paper, job.sheet, job.percent))
        for job in all_jobs(quick=False)
    }


@pytest.fixture(scope="module")
def paper():
    return read_published()


@pytest.fixture(scope="module")
def exact(paper):
    return reproduction(_figures(paper), quick=False)


def test_figures_equal_to_the_papers_agree_wherever_it_does_not_contradict_itself(exact):
    """Its 0.17 N for 9 wt% do not follow from its own noise floor, gauge factor and modulus: the one that differs."""
    differing = [(r.group, r.name) for t in exact.tables for r in t.rows if r.agrees is False]
    assert differing == [("9 wt%", "least force, from the noise floor")]
    undecided = {r.name for t in exact.tables for r in t.rows if r.agrees is None}
    assert undecided == {
        "E on the sheet, 60 s held",
        "gauge factor between the pins",
        "σ_n, printed in mS; ours relative",
    }


def test_figures_far_from_the_papers_differ_and_every_row_says_why(paper):
    def far(sheet):
        moved = {}
        for name in ("resistance", "modulus", "noise_figure", "noise_floor"):
            ours = getattr(sheet, name)
            moved[name] = replace(ours, value=10 * ours.value, uncertainty=0.0)
        return replace(sheet, **moved)

    found = reproduction(_figures(paper, far), quick=False)
    rows = [row for table in found.tables[:2] for row in table.rows if row.ours.simulated_on == "uniform"]
    assert all(row.agrees is False for row in rows if row.rule is not Rule.NONE)
    noise = [row for row in rows if row.name in ("NF", "noise floor, relative (3.3.2)")]
    assert len(noise) == 4
    assert all(row.reason for row in noise)


def test_the_document_has_every_row_of_every_table(exact):
    document = json_document(exact)
    assert list(document) == ["about", *_KEYS, "presses"]
    assert all(document[key]["compared"] >= document[key]["agreeing"] > 0 for key in _KEYS)
    assert len(document["table4"]["rows"]) == 27
    assert len(document["table5"]["rows"]) == len(document["tableF6"]["rows"]) == 20
    assert document["table3"]["rows"][1]["paper"]["band"] == "ok"


def test_inputs_of_the_simulation_are_told_from_outcomes(exact):
    kinds = {row.name: row.kind for table in exact.tables[:2] for row in table.rows}
    assert [name for name, kind in kinds.items() if kind is ValueOrigin.INPUT] == [
        "R_int",
        "E",
        "gauge factor",
        "NF",
        "noise floor, relative (3.3.2)",
    ]


@pytest.mark.rest
def test_the_page_stands_by_itself_and_says_that_ours_is_simulated(exact):
    outcome = reproduction_outcome(exact)
    page = render_sections(outcome.page, outcome.sections)
    assert page.count("<svg") == 6
    assert "<script" not in page
    assert "https:" not in page
    assert "This report does not describe a real sensor" in page
    for table in exact.tables:
        assert table.title in page


def test_the_documented_command_writes_its_page_and_prints_tables_or_one_document(
    paper, tmp_path, monkeypatch, capsys
):
    """As typed on its page of the documentation; the simulation, which takes longer, is replaced by figures."""
    how_to = (Path(__file__).resolve().parents[3] / "docs" / "how-to" / "reproduce-the-paper.md").read_text()
    (command,) = re.findall(r"^\$ cbsr-qa (.*)$", how_to, re.M)
    monkeypatch.chdir(tmp_path)
    asked = []

    def by_hand(jobs, processes, tell):
        asked.append(jobs)
        figures = _figures(paper)
        return {job: figures[replace(job, quick=False)] for job in jobs}

    monkeypatch.setattr(reproduce, "_simulate_all", by_hand)
    assert run_guarded(shlex.split(command)) == 0
    assert "Table F.6: SD of ten random loads, and our simulation" in capsys.readouterr().out
    assert [path.name for path in tmp_path.iterdir()] == ["paper.html"]
    assert run_guarded(["reproduce", "paper", "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert list(document)[:9] == ["about", *_KEYS]
    assert document["about"]["quick"] is False
    assert asked == [all_jobs(quick=True), all_jobs(quick=False)]


@pytest.mark.parametrize("as_json", [False, True])
def test_a_run_that_stops_ends_the_command_with_the_sensor_and_the_rule(as_json, monkeypatch, capsys):
    """An electrode that is open from the beginning stops the first run at its first frame."""
    monkeypatch.setattr(reproduce, "cpu_count", lambda: 1)
    monkeypatch.setitem(reproduce_runs._SETTINGS, "uniform", ("simulated", "paper", "faulty-electrode"))
    assert run_guarded(["reproduce", "paper", "--quick", *(["--json"] if as_json else [])]) == 3
    said = capsys.readouterr()
    assert (
        "the simulated 8 wt% uniform sheet (station simulated, recipe paper, scene faulty-electrode, seed 1)"
        in said.err
    )
    assert "the run was broken: rule 'compliance'" in said.err
    assert "report" not in said.err
    if as_json:
        assert "electrode 12 may be open" in json.loads(said.out)["broken"]["reason"]
    else:
        assert said.out == ""


def _killed(job):
    os.kill(os.getpid(), signal.SIGKILL)


@pytest.mark.rest
def test_a_process_that_is_killed_is_said_to_be(monkeypatch):
    monkeypatch.setattr(reproduce, "simulate", _killed)
    with pytest.raises(NotReproducedError, match=r"wt% .* gave no figures: its process was killed"):
        reproduce.reproduce_paper(quick=True, processes=2)


def test_the_reason_of_a_worker_reaches_its_parent_whole():
    error = reproduction_error(all_jobs(quick=True)[0], "the run was aborted")
    there = pickle.loads(pickle.dumps(error))
    assert (str(there), there.document()) == (str(error), error.document())


def test_quick_presses_less_and_leaves_the_bench_sheet_out():
    full, quick = all_jobs(quick=False), all_jobs(quick=True)
    assert {job.sheet for job in full} - {job.sheet for job in quick} == {"bench"}
    for job in quick:
        longer = configuration_of(replace(job, quick=False)).recipe.phases
        pressed, all_pressed = (
            [phase.options for phase in phases] for phases in (configuration_of(job).recipe.phases, longer)
        )
        assert pressed != all_pressed
