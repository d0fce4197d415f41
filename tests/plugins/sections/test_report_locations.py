"""Sections of a run on single places: the grid of locations, its masks, and random loads."""

from dataclasses import replace
from statistics import fmean

import numpy as np
import pytest
from report_samples import without_blobs
from section_texts import observed, tables, texts

from cbsr_qa.domain.plan.limits import Limit, Outcome
from cbsr_qa.domain.plan.steps import Role
from cbsr_qa.domain.results.measurement import Measurement
from cbsr_qa.domain.results.report import Figure
from cbsr_qa.report.select import Measured, loads_of
from cbsr_qa_plugins.sections.loads import RandomLoads
from cbsr_qa_plugins.sections.locations import MaskComparison, NineLocations


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
    ("shift_mm", "said"), [(1.14, "a systematic error of the station"), (0.2, "no more than random scatter")]
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
    (words,) = [
        part.text for part in section.blocks if getattr(part, "text", "").startswith("The images show all locations")
    ]
    assert said in words
    assert f"{shift_mm:.2f} ± 0.11 mm" in words
    assert "mean error 0.4 mm, largest 0.8 mm" in words.replace("0.40", "0.4").replace("0.80", "0.8")


def test_trials_are_averaged_and_the_worst_outcome_shown(result):
    limit = Limit("centre_of_mass_error", "mm", None, 2.0)
    loads = [load for load in result.observation.loads if load.phase == "noise"]
    values = [0.5, 1.0, 3.0]
    measured = tuple(
        Measurement("centre_of_mass_error", v, "mm", phase="noise", location="L0", trial=k, load=k).judge(limit)
        for k, v in enumerate(values)
    )
    phases = (replace(result.record.phases[0], role=Role.GRID),)
    seen = observed(result, record=replace(result.record, phases=phases), loads=tuple(loads))
    (table,) = tables(NineLocations().render(replace(seen, measurements=measured)))
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
    section = NineLocations().render(observed(result, record=replace(run.record, phases=phases)))
    captions = [block.caption for block in section.blocks if isinstance(block, Figure)]
    assert [caption.partition(".")[0] for caption in captions] == ["Phase nine", "Phase random"]
    nine, strains, random = tables(section)
    assert "Presses" not in nine.columns
    assert len(nine.rows) == 9
    assert len(random.rows) == 10
    wanted = sorted(100 * load.record.load.strain for load in run.loads if load.phase == "random")
    assert [float(row[0]) for row in texts(strains)] == pytest.approx(wanted, rel=1e-4)
    assert {row[-1] for row in texts(strains)} == {"1 of 1"}


def test_loads_of_one_name_and_trial_are_told_apart_by_their_index_in_whatever_order(result):
    load = result.observation.loads[3]
    weak, strong = (replace(load, record=replace(load.record, index=k)) for k in (4, 5))
    about = {"phase": load.phase, "location": load.record.load.label, "trial": load.record.load.trial}
    measured = Measured([Measurement("e", v, "mm", load=k, **about) for k, v in ((5, 2.0), (4, 1.0))])
    assert measured.find("e", weak).value == 1.0
    assert measured.find("e", strong).value == 2.0
    assert measured.find("e", replace(load, record=replace(load.record, index=6))) is None
    assert measured.find("e", replace(weak, phase="another")) is None


def test_sections_ask_what_a_phase_is_for_and_not_who_made_it(result):
    phases = tuple(replace(phase, sequence="strangers-grid") for phase in result.record.phases)
    assert NineLocations().render(observed(result, record=replace(result.record, phases=phases)))
    nameless = tuple(replace(phase, sequence="location-grid", role=Role.OTHER) for phase in phases)
    assert NineLocations().render(observed(result, record=replace(result.record, phases=nameless))) is None


@pytest.mark.rest
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
