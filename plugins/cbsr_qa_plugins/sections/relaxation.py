"""Relaxations after presses and releases: fits on their traces, and settling times."""

from collections.abc import Iterator, Sequence

from cbsr_qa.analysis.run.agreement import DirectedAgreement, image_against_blobs, sheet_against_strip
from cbsr_qa.calibration.fits.agreement import SHAPE_MARGIN
from cbsr_qa.calibration.fits.settling import estimate_restricted_mean
from cbsr_qa.plugin import (
    Block,
    Cell,
    Figure,
    FitStatus,
    Measurement,
    Paragraph,
    RelaxationFit,
    RelaxationObservation,
    Role,
    RunObservation,
    RunResult,
    Table,
)
from cbsr_qa.report.draw.relaxation import SettledLoad, agreement_figure, relaxation_figure, settling_figure
from cbsr_qa.report.section import ObservedSection
from cbsr_qa.report.select import alike, loads_of, select_relaxed
from cbsr_qa.report.tables import format_or_dash, number, plain, plural, text_table, value_cell, with_uncertainty


class RelaxationFits(ObservedSection):
    """Section of relaxation fits and settling times (paper: Figs D.19 to D.22)."""

    title = "Relaxation and settling"

    def run_blocks(self, result: RunResult, run: RunObservation) -> Iterator[Block]:
        """Return traces, fits, settling times and rejected fits; nothing where no relaxation was fitted."""
        loads = select_relaxed(run.loads)
        if not loads:
            return
        signals = list(dict.fromkeys(r.signal for load in loads for r in load.relaxations))
        # Highlighted: the load held for this purpose, else the one with the best fits.
        highlighted = max(loads, key=lambda load: sum(r.fit.r_squared for r in load.relaxations))
        if held_for_this := select_relaxed(loads_of(run, Role.RELAXATION)):
            place = (held_for_this[0].label, held_for_this[0].group)
            highlighted = next((load for load in loads if (load.label, load.group) == place), highlighted)
        rows = [_fit_row(relaxation) for relaxation in highlighted.relaxations]
        columns = ("Signal", "After", "Form", "a₀", "τ₁ [s]", "τ₂ [s]", "R²", "Settled [s]")
        caption = f"Fits of {highlighted.label} ({highlighted.group}), G(t) = a₀ + a₁ exp(−t/τ₁) + a₂ exp(−t/τ₂)."
        fits = text_table(caption, columns, rows, (3, 4, 5, 6, 7))
        yield from (_traces(loads, highlighted, signals), fits)
        yield from _together(result.measurements)
        yield from (_times(loads, signals), _strain_table(loads, signals))
        yield from _agreements(run, result.measurements)
        rejected = [r.fit for load in loads for r in load.relaxations if r.fit.status is FitStatus.REJECTED]
        if rejected:
            yield Paragraph(_rejections(rejected, run.settings.r_squared_gate), "note")


def _traces(loads: Sequence[SettledLoad], highlighted: SettledLoad, signals: Sequence[str]) -> Figure:
    return Figure(
        f"Relaxation of {highlighted.label} ({highlighted.group}): readings (dots), fit of one or two exponentials"
        " (line), settling band (shaded) and settling time (dashed). Grey: all other presses.",
        f"Traces and fits of {', '.join(signals)} after the press and after the release.",
        relaxation_figure(loads, highlighted, signals),
    )


def _times(loads: Sequence[SettledLoad], signals: Sequence[str]) -> Figure:
    return Figure(
        "Settling time of every press (filled) and release (open), in the order they were made. Lines: means, where"
        " at least half of the loads gave a time. Triangle: a lower bound.",
        "Settling times of all loads, for loading and unloading.",
        settling_figure(loads, signals),
    )


def _together(measurements: Sequence[Measurement]) -> list[Block]:
    """One row a signal and direction: all loads fitted together, beside the mean of single loads."""
    common = [m for m in measurements if m.name == "common_settling_time"]
    means = {m.qualifier: m for m in measurements if m.name == "mean_settling_time"}
    if not common:
        return []
    rows: list[list[str | Cell]] = [
        [m.qualifier, value_cell(m), value_cell(means.get(m.qualifier)), m.how] for m in common
    ]
    caption = (
        "Settling of all loads together. Common: one fit to all traces, with common time constants and separate"
        " sizes. Mean: of single loads; too short if a trace does not show both time constants. ≥: a lower bound."
    )
    return [text_table(caption, ("Signal, after", "Common [s]", "Mean [s]", "Common fit"), rows, (1, 2))]


def _agreements(run: RunObservation, measurements: Sequence[Measurement]) -> Iterator[Block]:
    """Agreement of relaxations requested by this run's metrics: whole image and blobs, sheet and strip."""
    measured = {m.name for m in measurements}
    if "relaxation_shape_difference" in measured:
        yield from _agreement(image_against_blobs(run), "The whole image against the blobs")
    if "strip_relaxation_difference" in measured:
        yield from _agreement(sheet_against_strip(run), "The sheet against a strip of its material (2D against 1D)")


def _agreement(compared: Sequence[DirectedAgreement], words: str) -> list[Block]:
    if not compared:
        return []
    if all(agreement.found.why for agreement in compared):
        why = "; ".join(dict.fromkeys(agreement.found.why for agreement in compared))
        return [Paragraph(f"{words}: not compared, {why}.", "note")]
    caption = (
        f"{words}: relaxations relative to their change (above) and their difference (below), with 90 % intervals."
        f" Equivalent: the interval of the difference stays within ±{SHAPE_MARGIN:g} (shaded)."
    )
    shapes = "; ".join(
        f"{agreement.direction}: {agreement.found.why or agreement.found.shape}" for agreement in compared
    )
    return [Figure(caption, f"{words}. {shapes}.", agreement_figure(compared))]


def _rejections(fits: Sequence[RelaxationFit], gate: float) -> str:
    """Count rejected fits by reason, those of a low R² with their range."""
    low = [fit.r_squared for fit in fits if fit.why.startswith("R²")]
    reasons: dict[str, list[str]] = {}
    for fit in fits:
        if not fit.why.startswith("R²"):
            reasons.setdefault(alike(fit.why), []).append(fit.why)
    words = [f"{len(why)} because {why[0]}" for why in reasons.values()]
    if low:
        values = " to ".join(dict.fromkeys(number(bound, 2) for bound in (min(low), max(low))))
        words.insert(0, f"{len(low)} with R² below {gate:g} ({values})")
    return f"{plural(len(fits), 'fit was', 'fits were')} rejected: {', '.join(words)}."


def _fit_row(relaxation: RelaxationObservation) -> list[str]:
    fit, settling = relaxation.fit, relaxation.settling
    values = ["–"] * 3
    if fit.status is not FitStatus.REJECTED:
        pairs = zip(fit.time_constants_s, fit.time_constant_stderr_s, strict=False)
        taus = [with_uncertainty(tau, stderr) for tau, stderr in pairs]
        values = [with_uncertainty(fit.offset, fit.offset_stderr), *taus, "–", "–"][:3]
    settled = format_or_dash(settling.value_s, lambda value_s: f"{'≥ ' if settling.censored else ''}{value_s:.1f}")
    return [
        relaxation.signal,
        _motion_name(relaxation.loading),
        fit.status.value,
        *values,
        f"{fit.r_squared:.3f}",
        settled,
    ]


def _motion_name(loading: bool) -> str:
    return "press" if loading else "release"


def _strain_table(loads: Sequence[SettledLoad], signals: Sequence[str]) -> Table:
    classes = _strain_classes(loads)
    rows = []
    for signal in signals:
        for loading in (True, False):
            for words, members in classes.items():
                relaxations = [load.find(signal, loading) for load in members]
                rows.append(_strain_row(signal, loading, words, [r for r in relaxations if r is not None]))
    columns = ("Signal", "After", "Strain [%]", "Settling [s]", "Settled", "Later than window", "Rejected")
    caption = (
        "Settling by strain: mean ± standard deviation (Kaplan–Meier). ≥: a lower bound, because some presses did not"
        " settle within their window. No mean if more than half were rejected."
    )
    return text_table(caption, columns, [row for row in rows if row], (2, 3, 4, 5, 6))


def _strain_classes(loads: Sequence[SettledLoad]) -> dict[str, list[SettledLoad]]:
    """Group loads by strain; if there are more strains than the paper's six, in classes of 10 %."""
    exact = sorted({round(load.strain, 3) for load in loads})
    if len(exact) <= 6:
        return {f"{100 * s:.3g}": [load for load in loads if round(load.strain, 3) == s] for s in exact}
    lowers = sorted({int(load.strain * 10 + 1e-9) for load in loads})
    return {
        f"{10 * lower} to {10 * lower + 10}": [load for load in loads if int(load.strain * 10 + 1e-9) == lower]
        for lower in lowers
    }


def _strain_row(signal: str, loading: bool, strain: str, relaxations: Sequence[RelaxationObservation]) -> list[str]:
    if not relaxations:
        return []
    timed = [(r.settling.value_s, r.settling.censored) for r in relaxations if r.settling.value_s is not None]
    times_s, is_censored = [time_s for time_s, _ in timed], [is_late for _, is_late in timed]
    mean = "–"
    if timed and 2 * len(timed) >= len(relaxations):
        mean = plain(times_s[0], "s")
        if len(times_s) > 1:
            mean = with_uncertainty(*estimate_restricted_mean(times_s, is_censored))
        mean = f"≥ {mean}" if any(is_censored) else mean
    censored = sum(is_censored)
    counts = (len(timed) - censored, censored, len(relaxations) - len(timed))
    return [signal, _motion_name(loading), strain, mean, *map(str, counts)]
