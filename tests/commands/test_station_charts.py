"""A run updates its station's charts, its report and its warnings say which signals, and so does the report again."""

import json
from dataclasses import replace
from datetime import UTC, datetime

import pytest
from command import cbsr_qa

from cbsr_qa.domain.results.charts import ChartReference
from cbsr_qa.store.opening import open_store

pytestmark = pytest.mark.rest

RUN = ("run", "--station", "simulated", "--recipe", "golden-check")


def test_a_station_that_is_out_of_control_says_so_on_its_reports(tmp_path):
    cbsr_qa(tmp_path, *RUN, "--serial", "G-1", "--json")
    with open_store(f"sqlite:///{tmp_path / 'var' / 'cbsr-qa.db'}") as store:
        (before,) = store.runs.find()
        measured = next(m for m in store.analyses.load(before.run)[0].measurements if m.name == "noise_floor")
        reference = ChartReference(
            reference=store.new_id(),
            station=before.station,
            recipe=before.recipe,
            golden=None,
            name=measured.name,
            phase=measured.phase,
            qualifier=measured.qualifier,
            unit=measured.unit,
            mean=measured.value / 2,
            deviation=measured.value / 100,
            runs=30,
            first_run=before.run,
            last_run=before.run,
            operator="Zoë",
            made_at=datetime.now(UTC),
            why="too low by half",
        )
        well = replace(reference, reference=store.new_id(), name="unknown_metric", mean=1.0, deviation=1.0)
        store.charts.save([reference, well])
    cbsr_qa(tmp_path, *RUN, "--serial", "G-2", "--json")
    with open_store(f"sqlite:///{tmp_path / 'var' / 'cbsr-qa.db'}") as store:
        latest = store.runs.find()[0]
        warnings = store.analyses.load(latest.run)[0].warnings
    said = "noise floor, chart i-mr, signals since the run of sensor G-2 on "
    assert any("station simulated is out of control" in words and said in words for words in warnings)
    (page,) = (tmp_path / "var" / "reports").glob("G-2-*.html")
    assert "The station is out of control: 1 of 2 control charts of station simulated signal." in page.read_text()
    (first,) = (tmp_path / "var" / "reports").glob("G-1-*.html")
    assert "out of control" not in first.read_text()
    page.unlink()
    cbsr_qa(tmp_path, "report", "G-2")
    assert "The station is out of control: 1 of 2 control charts" in page.read_text()
    cbsr_qa(tmp_path, "report", "G-1")  # as it was known then
    assert "out of control" not in first.read_text()
    done = cbsr_qa(tmp_path, "charts", "--station", "simulated", "--metric", "noise_floor", "--json", check=False)
    assert done.returncode == 1
    assert json.loads(done.stdout)["charts"][0]["signal"]["since_run"] == latest.run
