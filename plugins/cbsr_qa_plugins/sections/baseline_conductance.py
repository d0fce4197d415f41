"""The baseline conductance ρ̄₀ at each location."""

from cbsr_qa.domain.calibration import BaselineConductance, Calibration
from cbsr_qa.domain.load_events import RecordingResult
from cbsr_qa.domain.report import Block, Paragraph, RunResult, Section, Table
from cbsr_qa.domain.sensor import Parameter
from cbsr_qa.report.figures_baseline import baseline_figure
from cbsr_qa.report.numbers import number, with_uncertainty
from cbsr_qa.report.select import mean_deviation
from cbsr_qa.report.tables import text_table


class BaselineConductanceMap:
    """Section of ρ̄₀ as issued in the calibration (paper: Eq 7)."""

    def render(self, result: RunResult | RecordingResult) -> Section | None:
        """Return the section; None where no calibration was issued or it holds no place."""
        if not isinstance(result, RunResult) or result.calibration is None or not result.calibration.baseline:
            return None
        calibration = result.calibration
        blocks: list[Block] = [Paragraph(_in_words(calibration.baseline))]
        if any(place.value is not None for place in calibration.baseline):
            blocks.append(
                baseline_figure(
                    calibration.baseline,
                    calibration.sensor_type,
                    calibration.indenter,
                    caption="Baseline conductance ρ̄₀ where loads were calibrated: the apparent response of the place,"
                    " relative image units. Right: the same with its uncertainty (one standard deviation).",
                    alternative=_in_words(calibration.baseline),
                )
            )
        blocks += [_places(calibration.baseline), _model(calibration)]
        if calibration.assumed:
            names = ", ".join(calibration.assumed)
            text = f"Assumed from the material file and not measured on this sensor: {names}."
            blocks.append(Paragraph(text, "note"))
        blocks += [Paragraph(f"Reduced validity: {why}.", "warning") for why in calibration.validity.reduced]
        return Section("Baseline conductance", tuple(blocks))


def _in_words(places: tuple[BaselineConductance, ...]) -> str:
    values = [place.value for place in places if place.value is not None]
    found = mean_deviation(values)
    if found is None:
        return "No load says anything about the baseline conductance."
    mean, deviation = found
    spread = "" if not deviation or not mean else f", a spread of {100 * deviation / abs(mean):.2g} % over the sheet"
    missing = "" if len(values) == len(places) else f"; {len(places) - len(values)} without a value"
    return f"Mean {number(mean)} over {len(values)} of {len(places)} locations{spread}{missing}."


def _places(places: tuple[BaselineConductance, ...]) -> Table:
    rows = []
    for place in places:
        value = "none" if place.value is None else with_uncertainty(place.value, place.stderr)
        at = f"{place.x_mm:g}, {place.y_mm:g}".replace("-", "−")
        rows.append([place.location, at, value, str(place.loads), place.why])
    columns = ("Location", "x, y [mm]", "ρ̄₀ [relative]", "Loads", "Remark")
    return text_table("ρ̄₀ per location.", columns, rows, (1, 2, 3))


def _model(calibration: Calibration) -> Table:
    stress, strain = calibration.against_stress, calibration.against_strain
    parameters = (
        ("α against stress", stress.slope, "1/kPa"),
        ("β against stress", stress.intercept, "relative"),
        ("α against strain", strain.slope, "relative per unit strain"),
        ("β against strain", strain.intercept, "relative"),
    )
    rows = [[name, _value(parameter), unit, parameter.source] for name, parameter, unit in parameters]
    caption = "Quasi-static model Δρ/ρ₀ = α · x + β used with ρ̄₀, and where each parameter comes from."
    return text_table(caption, ("Parameter", "Value", "Unit", "Source"), rows, (1,))


def _value(parameter: Parameter) -> str:
    return with_uncertainty(parameter.value, parameter.stderr)
