"""Section of the data sheet: what was measured, what was not and why, and figures where a picture says more."""

import re
from dataclasses import replace

import numpy as np
import pytest
from load_samples import Sampler
from report_samples import sample_run
from section_texts import blocks, observed

from cbsr_qa.domain.plan.steps import Role
from cbsr_qa.domain.readings.loads import EasedStrain, Load, LoadRecord
from cbsr_qa.domain.results.measurement import Measurement
from cbsr_qa.domain.results.observation import LoopObservation, Trace
from cbsr_qa.domain.results.report import Figure, Table
from cbsr_qa.report.svg import check_svg
from cbsr_qa_plugins.metrics.data_sheet import Hysteresis, Nonlinearity, Repeatability
from cbsr_qa_plugins.metrics.mechanics import ApparentModulus
from cbsr_qa_plugins.sections.data_sheet import DataSheet

_STRAINS = (0.1, 0.2, 0.3)


@pytest.fixture(scope="module")
def result():
    """The sample run with a grid of three places, three strains and two trials."""
    plain = sample_run(size_mm=6.0)
    sampler, wanted = (
        Sampler(size_mm=6.0),
        [Load(f"L{k}", 15.0 * k, 0.0, strain, trial) for strain in _STRAINS for trial in range(2) for k in range(3)],
    )
    loads = tuple(sampler.load("nine", index, load, 124.0 * index) for index, load in enumerate(wanted))
    observation = replace(plain.observation, loads=loads)
    metrics = (Repeatability(), Nonlinearity(), ApparentModulus())
    measured = tuple(m for metric in metrics for m in metric.measure_run(observation))
    return replace(plain, observation=observation, measurements=measured)


@pytest.fixture(scope="module")
def section(result):
    return DataSheet().render(result)


def rows(section):
    table, *_ = blocks(section, Table)
    return {row[0].text: [cell.text for cell in row[1:]] for row in table.rows}


def test_the_table_holds_what_was_measured_with_unit_and_uncertainty(result, section):
    found = rows(section)
    whole = {(m.name, m.qualifier): m for m in result.measurements if not m.location}
    for title, name in (("Repeatability", "repeatability"), ("Nonlinearity", "nonlinearity")):
        value, how = found[title]
        measured = whole[(name, "")]
        number, _, error = value.removesuffix("\N{NO-BREAK SPACE}%").partition(" ± ")
        assert float(number) == pytest.approx(measured.value, abs=float(error))
        assert float(error) == pytest.approx(measured.uncertainty, rel=0.2)
        assert how == measured.how
    assert found["Apparent modulus"][0].endswith("kPa")
    assert "Creep" not in found  # the recipe does not measure it


def test_hysteresis_is_said_to_be_missing_with_the_reason(result, section):
    value, why = rows(section)["Hysteresis"]
    assert value == "not determined"
    assert "from below and from above" in why
    asked = (*result.measurements, *Hysteresis().measure_run(result.observation))
    found = rows(DataSheet().render(replace(result, measurements=asked)))
    assert found["Hysteresis"][0] == "not determined"
    assert "hysteresis-loop" in found["Hysteresis"][1]


def looped():
    """Three strains up and two down, 5 % of the span apart at 10 %, which settle at once."""
    strains, outputs = (0.05, 0.1, 0.2, 0.1, 0.05), (0.25, 0.5, 1.0, 0.55, 0.25)
    eased = tuple(EasedStrain(strain, 60.0 * k - 1, 60.0 * k) for k, strain in enumerate(strains) if k)
    record = LoadRecord(0, Load("H0", 0.0, 0.0, 0.05, 0), -1.0, 0.0, 300.0, 301.0, 360.0, eased=eased)
    time_s = np.concatenate([np.arange(60.0 * k + 1.25, 60.0 * (k + 1) - 1, 2.5) for k in range(5)])
    index = (time_s // 60).astype(int)
    noise = 1e-3 * np.random.default_rng(5).standard_normal(len(time_s))
    output = Trace("output", "1", time_s, np.array(outputs)[index] + noise)
    return LoopObservation(
        "loop", (record,), output, 1e-3, Trace("stress", "kPa", time_s, 100 * np.array(strains)[index])
    )


def test_a_loop_has_its_rows_and_its_figure(result):
    seen = observed(result, loops=(looped(),))
    measured = (*result.measurements, *Hysteresis().measure_run(seen.observation))
    section = DataSheet().render(replace(seen, measurements=measured))
    value, _, error = rows(section)["Hysteresis"][0].removesuffix("\N{NO-BREAK SPACE}%").partition(" ± ")
    assert float(value) == pytest.approx(5.0, abs=4 * float(error))
    assert float(error) < 0.1
    assert "1 loop" in rows(section)["Hysteresis"][1]
    assert "creep included" in rows(section)["– with creep, as read"][1]
    _, loop, _ = blocks(section, Figure)
    assert check_svg(loop.svg)
    assert "1 location; the branches differ by at most" in loop.alternative


def test_what_could_not_be_determined_says_why(result):
    lost = Measurement("creep", None, "%", how="no force was recorded under a hold")
    found = rows(DataSheet().render(replace(result, measurements=(*result.measurements, lost))))
    assert found["Creep"] == ["not determined", "no force was recorded under a hold"]


def test_repeatability_by_strain_is_one_row(section):
    _, table = blocks(section, Table)
    assert table.columns == ("Strain", "10 %", "20 %", "30 %")
    assert len(table.rows) == 1


def test_the_figures_show_every_place(result, section):
    characteristic, maps = blocks(section, Figure)
    for figure in (characteristic, maps):
        check_svg(figure.svg)
    measured = next(m for m in result.measurements if m.name == "nonlinearity" and not m.qualifier and not m.location)
    said = float(re.search(r"by at most ([\d.]+) %", characteristic.alternative)[1])
    assert said == pytest.approx(measured.value, rel=0.02)
    assert "3 locations" in characteristic.alternative
    for label in ("L0", "L1", "L2"):
        assert f">{label}<" in maps.svg
    assert "apparent modulus 132 to 132 kPa" in maps.alternative


def test_one_strain_has_no_curve_but_a_map(result):
    loads = tuple(load for load in result.observation.loads if load.record.load.strain == 0.2)
    assert len(blocks(DataSheet().render(observed(result, loads=loads)), Figure)) == 1


def test_a_recipe_without_these_metrics_has_no_such_section(result):
    assert DataSheet().render(replace(result, measurements=())) is None
    random = tuple(replace(phase, role=Role.RANDOM) for phase in result.observation.record.phases)
    shown = DataSheet().render(observed(result, record=replace(result.observation.record, phases=random)))
    assert blocks(shown, Figure) == []
