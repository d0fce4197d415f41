"""What ``cbsr-qa compare`` says of groups that cannot be compared: in the headline, among the first, not hidden."""

from dataclasses import replace

import numpy as np
import pytest
from compared_fleets import ERROR, NOW, compared, fleet, page_of, run_of, table_of
from stored_lots import judged, store_run

from cbsr_qa.cli.main import run_guarded
from cbsr_qa.domain.errors import RefusedError
from cbsr_qa.domain.plan.limits import Outcome
from cbsr_qa.domain.results.measurement import Measurement, Verdict
from cbsr_qa.report.terminal import terminal_lines
from cbsr_qa.store.opening import open_store
from cbsr_qa.studies.compare.comparison import compare
from cbsr_qa.studies.compare.figures import strips
from cbsr_qa.studies.compare.report import compare_outcome
from cbsr_qa.studies.compare.terms import By, Terms

BOTH = [("41", "A"), ("42", "A"), ("41", "B"), ("42", "B")]
APART = [("43", "C")]


def made_of(plan, values=None, terms=None, names=("gap", "noise"), material=None):
    """Compare runs of (batch, station), a sensor each; ``values`` (R, metrics) are noise where none are given."""
    random = np.random.default_rng(4)
    values = random.standard_normal((len(plan), len(names))) if values is None else np.asarray(values, float)
    runs = [
        run_of(number, batch, station, material=(material or {}).get(batch, "cbsr"))
        for number, (batch, station) in enumerate(plan)
    ]
    table = table_of(runs, values, names)
    kept = ~np.isnan(table.value)
    columns = {name: getattr(table, name)[kept] for name in ("run", "kind", "value", "state")}
    return compare_outcome(compare(replace(table, **columns), terms or Terms(By.BATCH), NOW))


def test_runs_without_any_measurement_are_counted_and_nothing_is_compared(url, tmp_path, capsys):
    with open_store(url, durable=False) as store:
        for number, batch in enumerate(("41", "42", "42")):
            store_run(store, f"S-{number}", (), batch=batch, verdict=Verdict(Outcome.NOT_MEASURED, "drift"))
    page = tmp_path / "page.html"
    asked = ["compare", "--by", "batch", "--database", url]
    assert run_guarded([*asked, "--output", str(page)]) == 3
    said = capsys.readouterr().out
    assert "nothing could be compared" in said
    assert "Nothing was measured: no run that counts holds a measurement." in said
    assert "not measured" in said
    assert "Nothing was measured" in page.read_text()
    assert run_guarded([*asked, "--json"]) == 3


def test_a_group_that_cannot_be_compared_is_in_the_headline_and_why_is_said_first():
    shift = [(3.0 if batch == "43" else 0.0, 0.0) for batch, _ in BOTH * 6 + APART * 12]
    made = made_of(BOTH * 6 + APART * 12, np.random.default_rng(4).standard_normal((36, 2)) + shift)
    assert made.result.headline == "41 and 42: no difference shown in any of 2 metrics; 43 cannot be compared"
    said = made.result.sentences
    assert said[0].startswith("All metrics not compared: 43 and 41 cannot be compared: 43 ran on C only")
    assert next(n for n, words in enumerate(said) if "A t test" in words) > 0
    html = page_of(made)
    assert html.index("43 ran on C only") < html.index("Differences")


def test_the_terminal_has_two_facts_and_leaves_notes_to_the_page():
    """Batch 42 ran mostly at B, which reads higher: a t test blames the batch, which changes no decision."""
    plan = [("41", "A")] * 12 + [("41", "B")] * 4 + [("42", "A")] * 4 + [("42", "B")] * 12
    values = np.random.default_rng(4).standard_normal((32, 2)) + [[2.0 * (at == "B")] * 2 for _, at in plan]
    made = made_of(plan, values)
    lines = list(terminal_lines(made.page, made.sections))
    assert [name for name, _ in made.page.identity] == ["Compared", "Runs"]
    assert "A t test" in " ".join(made.result.sentences)
    assert "A t test" in page_of(made)
    assert not any("A t test" in line for line in lines)


def test_a_group_that_lacks_a_metric_is_said_to_be_compared_in_part():
    values = np.random.default_rng(5).standard_normal((24, 2))
    plan = [("41", "A"), ("42", "A"), ("43", "A")] * 8
    values[2::3, 1] = np.nan
    made = made_of(plan, values)
    assert made.result.headline.endswith("in any of 2 metrics; 43 could not be compared in 1 of 2 metrics")


def test_the_reference_is_of_the_groups_most_others_can_be_compared_with():
    made = made_of(BOTH * 6 + APART * 20)
    assert made.result.reference == "41"
    assert "The reference is 41: 43 has most sensors, and cannot be compared with 41, 42" in made.result.warnings
    (station, apart) = made.result.of_metrics[0].stations
    assert (station.station, station.reference) == ("B", "A")
    assert station.difference is not None
    assert apart.difference is None
    named = made_of(BOTH * 6 + APART * 20, terms=Terms(By.BATCH, groups=("43", "41", "42")))
    assert not named.result.compared
    assert "Nothing can be compared with 43; 41, 42 can among themselves: --groups 41,42" in named.result.warnings


def test_stations_are_compared_with_the_batches_of_materials_taken_out():
    plan = [("41", "A"), ("42", "A"), ("42", "B"), ("43", "B")] * 10
    away = {"41": 0.0, "42": 2.0, "43": 4.0}
    values = 0.1 * np.random.default_rng(6).standard_normal((40, 2)) + [[away[batch]] * 2 for batch, _ in plan]
    materials = {"41": "soft", "42": "soft", "43": "soft"}
    made = made_of(plan, values, Terms(By.MATERIAL), material=materials)
    by_station = made_of(plan, values, Terms(By.STATION), material=materials)
    (station,) = made.result.of_metrics[0].stations
    assert station.low <= 0.0 <= station.high
    assert station.difference == by_station.result.of_metrics[0].differences[0].difference
    assert "adjusted for batches" in page_of(made)


def test_groups_without_scatter_are_said_to_read_what_they_read_and_not_tested_for_likeness():
    plan = BOTH * 4
    noise = np.random.default_rng(7).standard_normal(16)
    values = np.column_stack([[3.4101 if batch == "41" else 3.4102 for batch, _ in plan], noise])
    made = made_of(plan, values, Terms(By.BATCH, margins={"gap": 0.3}))
    said = " ".join(made.result.sentences)
    assert (
        "Gap: all sensors of each group read the same (41 3.4101 mm, 42 3.4102 mm), so no test is possible." in said
    )
    assert (
        made.result.headline == "41 and 42: no difference shown in noise; 42 could not be compared in 1 of 2 metrics"
    )


@pytest.mark.parametrize("option", ["margins", "detect"])
def test_margins_and_differences_of_metrics_that_are_not_compared_are_refused(url, option):
    fleet(url, sensors=6, both=2)
    with pytest.raises(RefusedError, match="which is not among the metrics to compare: drift") as raised:
        compared(url, names=("drift",), **{option: {ERROR: 0.3}})
    assert f"--metric {ERROR}" in raised.value.remedy
    assert compared(url, names=("drift",)).result.headline == "41 and 42: no difference shown in drift"


def test_every_row_is_named_with_both_ends_of_long_names_and_one_sensor_is_a_point():
    long = "a batch with a name that is too long 43"
    samples = [(f"B{k}", "A", np.arange(3.0)) for k in range(36)] + [(long, "A", np.array([1.0]))]
    image = strips("gap [mm]", samples, [name for name, *_ in samples])
    assert all(f"B{k}, A" in image for k in range(36))
    assert "a batch with…ng 43, A" in image
    assert "too long" not in image


def test_empty_tables_and_columns_are_left_out(url):
    with open_store(url, durable=False) as store:
        for number in range(8):
            values = judged((Measurement(ERROR, 2.0 + 0.1 * number, "mm", 0.1, "nine locations", "L1", 0),))
            store_run(store, f"S-{number}", values, batch=("41", "42")[number % 2])
    html = page_of(compared(url))
    assert "Cpk" in html
    assert "why not" not in html
    assert "not measured" not in html
    assert "by other methods" not in page_of(made_of([("41", "A"), ("42", "A")], names=("gap",)))
