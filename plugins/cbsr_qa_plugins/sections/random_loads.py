"""Random loads on a polar plot, with the error each was seen with."""

from math import atan2, degrees, hypot

from cbsr_qa.domain.load_events import RecordingResult
from cbsr_qa.domain.report import Cell, RunResult, Section
from cbsr_qa.domain.steps import Role
from cbsr_qa.report.figures_loads import random_loads_figure
from cbsr_qa.report.loads import seen_loads
from cbsr_qa.report.numbers import with_uncertainty
from cbsr_qa.report.select import Measured, loads_of, observed, spread_text
from cbsr_qa.report.tables import text_table, value_cell


class RandomLoads:
    """Section of the loads that were drawn at random (paper: Fig 11, Table 5)."""

    def render(self, result: RunResult | RecordingResult) -> Section | None:
        """Return the section; None where none were pressed."""
        run = observed(result)
        loads = loads_of(run, Role.RANDOM) if run else ()
        if run is None or not loads or not isinstance(result, RunResult):
            return None
        measured = Measured(result.measurements)
        seen = seen_loads(loads, run, measured)
        mean = spread_text([load.error_mm for load in seen if load.error_mm is not None], "mm")
        figure = random_loads_figure(
            seen,
            run.record.sensor_type,
            caption="Random loads, true to place; discs grow with strain. Crosses: where the centre of mass was"
            " seen. Right: error against strain; a weak press is harder to place.",
            alternative=f"{len(seen)} random loads; error {mean} mm (mean ± standard deviation).",
        )
        rows: list[list[str | Cell]] = []
        for load in loads:
            wanted = load.record.load
            polar = f"{hypot(wanted.x_mm, wanted.y_mm):.1f}, {degrees(atan2(wanted.y_mm, wanted.x_mm)) % 360:.0f}°"
            force = "–" if load.force_N is None else with_uncertainty(load.force_N, load.force_stderr_N)
            error = value_cell(measured.of_load("centre_of_mass_error", load))
            overlap = value_cell(measured.of_load("area_overlap", load))
            rows.append([wanted.label, polar, f"{100 * wanted.strain:.1f}", force, error, overlap])
        columns = ("Load", "r [mm], θ", "Strain [%]", "Force [N]", "E_CoM [mm]", "A_OL [%]")
        table = text_table(f"Random loads: error {mean} mm over all.", columns, rows, (1, 2, 3, 4, 5))
        return Section("Random loads", (figure, table))
