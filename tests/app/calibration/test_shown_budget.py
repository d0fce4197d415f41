"""The budget of a force as ``calibration show`` gives it: every input with kind and degrees of freedom."""

from dataclasses import replace
from math import hypot, inf

import pytest
from certificates import CELL
from force_calibration import force_calibration

from cbsr_qa.app.calibration.page import show_calibration
from cbsr_qa.app.calibration.shown import ShownComponent
from cbsr_qa.calibration.file.hdf5 import stamp, write_calibration
from cbsr_qa.domain.results.expanded_force import BudgetComponent


@pytest.fixture(scope="module")
def outcome(tmp_path_factory):
    path = tmp_path_factory.mktemp("shown") / "sensor.h5"
    write_calibration(path, stamp(replace(force_calibration(), standards=(CELL,))))
    return show_calibration(path, every_field=True)


def test_every_input_has_its_kind_and_they_add_up(outcome):
    forces = outcome.result.expanded_forces
    for one in (*forces, *(force.in_use for force in forces)):
        assert {part.kind for part in one.components} <= {"A", "B"}
        parts = hypot(*(part.standard_uncertainty_N for part in one.components))
        assert parts == pytest.approx(one.standard_uncertainty_N)
        assert sum(part.share for part in one.components) == pytest.approx(1)


def test_infinite_degrees_of_freedom_are_null_as_json_has_no_infinity():
    part = BudgetComponent("load cell", "B", -0.5, inf, 1.0, "certificate K-7", shared=True)
    shown = ShownComponent.from_component(part)
    assert (shown.dof, shown.standard_uncertainty_N, shown.kind, shown.shared) == (None, 0.5, "B", True)
    assert ShownComponent.from_component(replace(part, dof=3.5)).dof == 3.5


def test_the_table_lists_the_inputs_of_the_largest_uncertainty(outcome):
    (section,) = [one for one in outcome.sections if one.title == "Expanded uncertainty of force"]
    _, inputs = section.blocks
    worst = max(outcome.result.expanded_forces, key=lambda one: one.in_use.U_N)
    assert [row[0].text for row in inputs.rows] == [part.name for part in worst.in_use.components]


def test_the_two_statements_of_95_percent_are_told_apart(outcome):
    said = " ".join(outcome.result.abilities)
    assert "The ± above is 1.96 standard errors" in said
    assert "U adds the other inputs that are stated" in said
