"""Sections of a run: what they show is what was measured, and they are silent where there is nothing to show."""

import importlib
import re
from dataclasses import replace
from statistics import fmean

import numpy as np
import pytest
from report_samples import ended_early, sample_recording, sample_run

from cbsr_qa.analysis.channel_quality import signal_to_noise_dB
from cbsr_qa.domain.measurement import Bound, Limit, Measurement
from cbsr_qa.domain.outcome import Outcome
from cbsr_qa.domain.relaxation import FitStatus
from cbsr_qa.domain.report import Figure, Paragraph, Table
from cbsr_qa.domain.steps import Role
from cbsr_qa.hookspecs import Kind
from cbsr_qa.report.select import Measured, alike, loads_of
from cbsr_qa.report.svg import checked_svg
from cbsr_qa_plugins.registry import BUILT_IN
from cbsr_qa_plugins.sections.baseline_conductance import BaselineConductanceMap
from cbsr_qa_plugins.sections.limits import Limits
from cbsr_qa_plugins.sections.load_images import LoadImages
from cbsr_qa_plugins.sections.mask_comparison import MaskComparison
from cbsr_qa_plugins.sections.nine_locations import NineLocations
from cbsr_qa_plugins.sections.noise_and_contacts import NoiseAndContacts
from cbsr_qa_plugins.sections.random_loads import RandomLoads
from cbsr_qa_plugins.sections.relaxation import RelaxationFits
from cbsr_qa_plugins.sections.time_and_accuracy import TimeAndAccuracy
from cbsr_qa_plugins.sections.traceability import Traceability

OF_A_RUN = {
    name: target
    for kind, name, target in BUILT_IN
    if kind is Kind.SECTION and not name.startswith(("recording", "characterisation"))
}


@pytest.fixture(scope="module")
def result():
    return sample_run(size_mm=6.0)


def made(name):
    module, _, factory = OF_A_RUN[name].partition(":")
    return getattr(importlib.import_module(f"cbsr_qa_plugins.{module}"), factory)()


def tables(section):
    return [block for block in section.blocks if isinstance(block, Table)]


def texts(table):
    return [[cell.text for cell in row] for row in table.rows]


def without_blobs(result):
    """The same run, in which no image rises above its noise floor."""
    observation = result.observation
    loads = tuple(
        replace(load, masks=tuple(replace(view, blobs=(), sensed=None) for view in load.masks))
        for load in observation.loads
    )
    lost = tuple(
        m if m.unit not in ("mm", "%", "mm²") else replace(m, value=None, how="not detected")
        for m in result.measurements
    )
    return replace(result, observation=replace(observation, loads=loads, timelines=()), measurements=lost)


@pytest.mark.parametrize("name", OF_A_RUN)
def test_every_section_has_content_that_can_be_shown(name, result):
    section = made(name).render(result)
    assert section.blocks
    for block in section.blocks:
        if isinstance(block, Figure):
            checked_svg(block.svg)
            assert block.caption
            assert block.alternative
        if isinstance(block, Table):
            assert block.rows
            assert all(len(row) == len(block.columns) for row in block.rows)
            assert max(block.numeric, default=0) < len(block.columns)


@pytest.mark.parametrize("name", OF_A_RUN)
def test_a_recording_is_none_of_their_business(name):
    assert made(name).render(sample_recording(1)) is None


@pytest.mark.parametrize("name", OF_A_RUN)
def test_a_run_that_was_not_analysed_gets_only_what_it_has(name, result):
    section = made(name).render(ended_early(result))
    assert (section is None) == (name not in ("station-check", "traceability"))


@pytest.mark.parametrize("name", OF_A_RUN)
def test_a_run_in_which_nothing_was_seen_is_reported_too(name, result):
    section = made(name).render(without_blobs(result))
    words = " ".join(cell.text for table in tables(section) for row in table.rows for cell in row)
    assert "nan" not in words.lower()


def test_the_location_table_holds_the_measured_values(result):
    run = result.observation
    (table,) = tables(NineLocations().render(result))
    errors = Measured(result.measurements).values("centre_of_mass_error", loads_of(run, Role.GRID))
    assert [row[0] for row in texts(table)] == [f"L{k}" for k in range(9)]
    assert [float(row[2]) for row in texts(table)] == pytest.approx(errors, abs=0.006)
    assert all(row[2].outcome is Outcome.PASS for row in table.rows)


def test_a_recipe_that_does_not_measure_places_is_not_said_to_have_seen_none(result):
    kept = tuple(m for m in result.measurements if m.name != "centre_of_mass_error")
    words, figure, *_ = NineLocations().render(replace(result, measurements=kept)).blocks
    assert "does not measure how far" in words.text
    assert "a cross was not measured" in figure.caption
    unseen = tuple(
        replace(m, value=None, uncertainty=None) if m.name == "centre_of_mass_error" else m
        for m in result.measurements
    )
    words, figure, *_ = NineLocations().render(replace(result, measurements=unseen)).blocks
    assert "none of the presses was seen" in words.text
    assert "a cross was not detected" in figure.caption


@pytest.mark.parametrize(
    ("shift_mm", "said"), [(1.14, "the station's part"), (0.2, "no more than their own scatter")]
)
def test_what_all_locations_share_is_the_stations_where_it_is_more_than_scatter(result, shift_mm, said):
    whole = (
        Measurement("registration_shift", shift_mm, "mm", 0.11),
        Measurement("registration_rotation", 0.3, "°", 0.26),
        Measurement("registration_scale", 0.99, "1", 0.005),
    )
    left = tuple(
        Measurement("registered_centre_of_mass_error", 0.1 * k, "mm", phase=load.phase, load=load.record.index)
        for k, load in enumerate(loads_of(result.observation, Role.GRID))
    )
    section = NineLocations().render(replace(result, measurements=(*whole, *left)))
    (words,) = [part.text for part in section.blocks if getattr(part, "text", "").startswith("All locations")]
    assert said in words
    assert f"{shift_mm:.2f} ± 0.11 mm" in words
    assert "mean error 0.4 mm, largest 0.8 mm" in words.replace("0.40", "0.4").replace("0.80", "0.8")


def test_trials_are_averaged_and_the_worst_outcome_shown(result):
    limit = Limit("centre_of_mass_error", "mm", None, 2.0)
    loads = [load for load in result.observation.loads if load.phase == "noise"]
    values = [0.5, 1.0, 3.0]
    measured = tuple(
        Measurement("centre_of_mass_error", v, "mm", phase="noise", location="L0", trial=k, load=k).judged(limit)
        for k, v in enumerate(values)
    )
    phases = (replace(result.record.phases[0], role=Role.GRID),)
    record = replace(result.record, phases=phases)
    observation = replace(result.observation, record=record, loads=tuple(loads))
    (table,) = tables(NineLocations().render(replace(result, observation=observation, measurements=measured)))
    (row,) = table.rows
    assert row[2].text == "3"
    assert float(row[3].text.partition(" ±")[0]) == pytest.approx(fmean(values), abs=0.05)
    assert row[3].outcome is Outcome.FAIL


def test_two_grids_stand_apart_and_strains_have_rows_of_their_own(result):
    """The second grid repeats labels of the first, at other places and a second strain."""
    run, phases = result.observation, result.record.phases
    phases = tuple(
        replace(phase, role=Role.GRID if phase.name in ("nine", "random") else phase.role) for phase in phases
    )
    observation = replace(run, record=replace(run.record, phases=phases))
    other = replace(result, observation=observation)
    section = NineLocations().render(other)
    captions = [block.caption for block in section.blocks if isinstance(block, Figure)]
    assert [caption.partition(".")[0] for caption in captions] == ["Phase nine", "Phase random"]
    nine, strains, random = tables(section)
    assert "Presses" not in nine.columns
    assert len(nine.rows) == 9
    assert len(random.rows) == 10
    wanted = sorted(100 * load.record.load.strain for load in run.loads if load.phase == "random")
    assert [float(row[0]) for row in texts(strains)] == pytest.approx(wanted, rel=1e-4)
    assert {row[-1] for row in texts(strains)} == {"1 of 1"}


def test_of_many_limits_the_closest_are_shown_and_the_others_folded(result):
    limit = Limit("e", "mm", None, 5.0)
    judged = tuple(
        Measurement("e", 0.05 * k, "mm", phase="nine", location="L0", load=k, strain=0.05 * (1 + k % 6)).judged(limit)
        for k in range(110)
    )
    closest, others = tables(Limits().render(replace(result, measurements=judged)))
    assert (closest.folded, others.folded) == (False, True)
    assert len(closest.rows) + len(others.rows) == 110
    failed = sum(m.outcome is Outcome.FAIL for m in judged)
    assert failed == 9
    assert [row[-1].outcome for row in closest.rows].count(Outcome.FAIL) == failed
    assert len(closest.rows) == 24
    assert texts(closest)[0][0] == "e (L0) at 10 % strain"  # the name alone would not say which press


def test_more_phases_than_fit_a_page_are_told_in_several_tables(result):
    measured = tuple(Measurement("e", float(k), "mm", phase=f"phase {k}") for k in range(9))
    parts = tables(Limits().render(replace(result, measurements=measured)))
    assert [part.columns[1:] for part in parts] == [
        tuple(f"phase {k}" for k in range(0, 3)),
        tuple(f"phase {k}" for k in range(3, 6)),
        tuple(f"phase {k}" for k in range(6, 9)),
    ]


def test_loads_of_one_name_and_trial_are_told_apart_by_their_index_in_whatever_order(result):
    load = result.observation.loads[3]
    weak, strong = (replace(load, record=replace(load.record, index=k)) for k in (4, 5))
    about = {"phase": load.phase, "location": load.record.load.label, "trial": load.record.load.trial}
    measured = Measured([Measurement("e", v, "mm", load=k, **about) for k, v in ((5, 2.0), (4, 1.0))])
    assert measured.of_load("e", weak).value == 1.0
    assert measured.of_load("e", strong).value == 2.0
    assert measured.of_load("e", replace(load, record=replace(load.record, index=6))) is None
    assert measured.of_load("e", replace(weak, phase="another")) is None


def test_sections_ask_what_a_phase_is_for_and_not_who_made_it(result):
    phases = tuple(replace(phase, sequence="strangers-grid") for phase in result.record.phases)
    observation = replace(result.observation, record=replace(result.record, phases=phases))
    assert NineLocations().render(replace(result, observation=observation))
    nameless = tuple(replace(phase, sequence="location-grid", role=Role.OTHER) for phase in phases)
    observation = replace(result.observation, record=replace(result.record, phases=nameless))
    assert NineLocations().render(replace(result, observation=observation)) is None


def test_masks_are_compared_over_the_grid_alone(result):
    (table,) = tables(MaskComparison().render(result))
    assert [row[0] for row in texts(table)] == ["25 %", "50 %", "75 %", "85 % (decides)"]
    assert {row[4] for row in texts(table)} == {"9 of 9"}
    nothing = tables(MaskComparison().render(without_blobs(result)))[0]
    assert {row[4] for row in texts(nothing)} == {"0 of 9"}


def test_random_loads_are_given_in_polar_coordinates(result):
    (table,) = tables(RandomLoads().render(result))
    for row, load in zip(texts(table), loads_of(result.observation, Role.RANDOM), strict=True):
        radius, angle = (float(part) for part in row[1].rstrip("°").split(", "))
        x, y = load.record.load.x_mm, load.record.load.y_mm
        assert (radius * np.cos(np.deg2rad(angle)), radius * np.sin(np.deg2rad(angle))) == pytest.approx(
            (x, y), abs=0.5
        )


def test_not_settled_is_a_bound_and_never_a_number(result):
    loads = list(result.observation.loads)
    first = loads[0].relaxations[0]
    late = replace(first, settling=replace(first.settling, value_s=60.0, censored=True))
    loads[0] = replace(loads[0], relaxations=(late, *loads[0].relaxations[1:]))
    section = RelaxationFits().render(replace(result, observation=replace(result.observation, loads=tuple(loads))))
    row = next(row for row in texts(tables(section)[1]) if row[5] == "1")
    assert row[3].startswith("≥ ")


def test_a_lower_bound_is_marked_wherever_it_is_written(result):
    about = {"phase": "nine", "location": "L0"}
    late = [Measurement("settling_time", 60.0, "s", trial=k, bound=Bound.LOWER, **about) for k in range(2)]
    common = Measurement(
        "common_settling_time", 60.0, "s", bound=Bound.LOWER, qualifier="stress, loading", how="slow"
    )
    (undecided, failed) = (common.judged(Limit(common.name, "s", None, upper)) for upper in (70.0, 50.0))
    for judged, margin in ((undecided, ""), (failed, "−10.0 s")):
        section = Limits().render(replace(result, measurements=(judged, *late, replace(late[0], bound=Bound.EXACT))))
        (row,) = texts(tables(section)[0])
        assert row[2] == "≥ 60.0\N{NO-BREAK SPACE}s"
        assert row[4].replace("\N{NO-BREAK SPACE}", " ") == margin
        assert ("slow" in row[0]) == (judged is undecided)
        assert texts(tables(section)[1])[0][1].startswith("≥ 60")
    relaxation = RelaxationFits().render(replace(result, measurements=(undecided,)))
    assert ["stress, loading", "≥ 60.0", "–", "slow"] in texts(tables(relaxation)[1])


def test_rejected_fits_are_counted_by_reason(result):
    loads = []
    for k, load in enumerate(result.observation.loads):
        worst = load.relaxations[0]
        why = f"R² {0.4 + k / 100:.3f} is below 0.85" if k != 7 else "the data do not determine a time constant"
        fit = replace(worst.fit, status=FitStatus.REJECTED, r_squared=0.4 + k / 100, why=why)
        bad = replace(worst, fit=fit, settling=replace(worst.settling, value_s=None))
        loads.append(replace(load, relaxations=(bad, *load.relaxations[1:])))
    observation = replace(result.observation, loads=tuple(loads))
    section = RelaxationFits().render(replace(result, observation=observation))
    (told,) = [block.text for block in section.blocks if isinstance(block, Paragraph)]
    assert told == (
        "23 fits were rejected: 22 with R² below 0.85 (0.40 to 0.62), 1 because the data do not determine a time"
        " constant."
    )
    by_strain = [row for row in texts(tables(section)[1]) if row[:2] == ["conductance", "press"]]
    assert {row[3] for row in by_strain} == {"–"}


def test_reasons_that_differ_in_numbers_only_are_alike():
    assert alike("R² 0.612 is below 0.85") == alike("R² 0.4 is below 0.9")
    assert alike("too few points: 3") != alike("R² 0.4 is below 0.9")


def test_the_baseline_section_says_what_was_assumed_and_reduced(result):
    section = BaselineConductanceMap().render(result)
    words = [block.text for block in section.blocks if isinstance(block, Paragraph)]
    assert any("α and β against stress" in text and "not measured" in text for text in words)
    assert any("only one strain" in text for text in words)
    assert BaselineConductanceMap().render(replace(result, calibration=None)) is None


def test_a_baseline_without_any_value_is_said_without_a_figure(result):
    empty = tuple(replace(place, value=None, stderr=None, why="no blob") for place in result.calibration.baseline)
    section = BaselineConductanceMap().render(
        replace(result, calibration=replace(result.calibration, baseline=empty))
    )
    assert not [block for block in section.blocks if isinstance(block, Figure)]
    assert {row[4] for row in texts(tables(section)[0])} == {"no blob"}


def test_signal_to_noise_is_level_over_deviation_from_a_line(result):
    unloaded = result.observation.unloaded
    one = unloaded.voltages[:, 3, 7]
    left = one - np.polyval(np.polyfit(unloaded.time_s, one, 1), unloaded.time_s)
    expected = 20 * np.log10(abs(one.mean()) / np.sqrt(left @ left / (len(one) - 2)))
    assert signal_to_noise_dB(unloaded)[3, 7] == pytest.approx(expected)
    drift = one[:1] * 1e-3 * (unloaded.time_s - unloaded.time_s.mean())
    drifting = replace(unloaded, voltages=unloaded.voltages + drift[:, None, None])
    assert signal_to_noise_dB(drifting)[3, 7] == pytest.approx(expected, abs=1e-6)
    assert signal_to_noise_dB(unloaded.select(slice(0, 2))) is None


def test_a_reading_that_never_changes_has_no_finite_ratio(result):
    run = result.observation
    frozen = run.unloaded.voltages.copy()
    frozen[:, 0, 5] = 1.0
    ratio = signal_to_noise_dB(replace(run.unloaded, voltages=frozen))
    assert np.isinf(ratio[0, 5])


def test_the_worst_contact_is_named(result):
    bad = [replace(m, value=95e3) if m.qualifier == "pair 7-8" else m for m in result.measurements]
    section = NoiseAndContacts().render(replace(result, measurements=tuple(bad)))
    captions = " ".join(block.caption for block in section.blocks if isinstance(block, Figure))
    assert re.search(r"pair 7.8 with 95.0.kΩ", captions)


def test_time_adds_up(result):
    section = TimeAndAccuracy().render(result)
    (table,) = tables(section)
    assert [row[2] for row in texts(table)] == ["3", "9", "10", "1"]
    assert "55 min" in section.blocks[0].text


def test_every_limit_is_listed_the_worst_first(result):
    failing = Measurement("strangers_metric", 9.0, "mm").judged(Limit("strangers_metric", "mm", None, 3.0))
    lost = Measurement("other", None, "1", how="why not").judged(Limit("other", "1", 0.0, None))
    section = Limits().render(replace(result, measurements=(*result.measurements, failing, lost)))
    rows = texts(tables(section)[0])
    assert len(rows) == sum(m.limit is not None for m in result.measurements) + 2
    assert rows[0][0] == "strangers metric"
    assert rows[0][4].startswith("−6.00")
    assert "why not" in rows[1][0]
    assert rows[1][2] == "not measured"


def test_a_strangers_measurement_is_shown_without_being_known(result):
    mine = Measurement("stickiness", 3.25, "mN", 0.4, qualifier="edge", phase="nine", location="L3", trial=0)
    section = Limits().render(replace(result, measurements=(*result.measurements, mine)))
    assert any(
        "stickiness (edge) [mN]" in row[0] and "3.2 ± 0.4" in " ".join(row) for row in texts(tables(section)[1])
    )


def test_what_could_not_be_measured_is_listed_once_with_its_reason(result):
    lost = tuple(
        Measurement("settling_time", None, "s", phase="nine", location=f"L{k}", trial=0, how=f"R² 0.{k} is too low")
        for k in range(1, 5)
    )
    section = Limits().render(replace(result, measurements=(*result.measurements, *lost)))
    (row,) = texts(tables(section)[-1])
    assert row == ["settling time", "nine", "L1, L2, L3, L4", "for example: R² 0.1 is too low"]


def test_only_so_many_images_are_printed_and_the_rest_is_said(result):
    many = tuple(
        replace(load) for load in (*result.observation.loads, *result.observation.loads, *result.observation.loads)
    )
    section = LoadImages().render(replace(result, observation=replace(result.observation, loads=many)))
    assert section.blocks[0].text.endswith("21 presses are not printed here; every frame is in the store.")


@pytest.mark.parametrize(("name", "criterion"), [("λ", "gcv"), ("components kept", "noise-figure"), ("μ", "")])
def test_the_regularisation_parameter_stands_under_its_own_name(result, name, criterion):
    run = result.observation
    choice = replace(run.reconstruction.choice, name=name, criterion=criterion)
    seen = replace(run, reconstruction=replace(run.reconstruction, choice=choice))
    rows = dict(texts(tables(Traceability().render(replace(result, observation=seen)))[2]))
    assert rows["Regularisation parameter"] == f"{name} = 0.0123"
    said = criterion or "criterion not stated"
    assert rows["Parameter chosen by"] == f"{said}: noise figure 1.00 on the nominal model"


def test_instruments_are_traceable(result):
    told = {"simulated": False, "calibration_due": "2027-01-31", "notes": (("address", "COM3"), ("tare", "0.02 N"))}
    bench = replace(result.record.identity.instruments[0], **told)
    identity = replace(result.record.identity, instruments=(bench, replace(bench, calibration_due=None, notes=())))
    section = Traceability().render(replace(result, record=replace(result.record, identity=identity)))
    rows = texts(tables(section)[0])
    assert rows[0][-3:] == ["no", "2027-01-31", "address: COM3; tare: 0.02 N"]
    assert rows[1][-3:] == ["no", "not stated", "–"]
    words = " ".join(cell for table in tables(section) for row in texts(table) for cell in row)
    assert result.record.identity.configuration_digest in words
