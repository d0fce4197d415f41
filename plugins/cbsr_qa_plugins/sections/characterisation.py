"""What press cycles on a strip tell about its material (paper 2.2 and 3.1)."""

from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np

from cbsr_qa.plugin import (
    Block,
    Characterisation,
    Figure,
    FittedLine,
    FrameBlock,
    Paragraph,
    PhaseRecord,
    Role,
    RunRecord,
    RunResult,
    StrainLevel,
    StrainSettling,
    Table,
    Trace,
)
from cbsr_qa.report.draw.time import timeline_figure
from cbsr_qa.report.section import RunSection
from cbsr_qa.report.tables import (
    format_or_dash,
    number,
    parameter_text,
    plural,
    quantity,
    text_table,
    with_uncertainty,
)

_SHOWN_STRAIN: Final = 0.25  # whose cycles the paper's Fig 6 shows
_BEFORE_S: Final = 5.0  # shown before their first press


class MaterialCharacterisation(RunSection):
    """Section of a material's lines, kernels and settling times (paper: Figs 5 to 8, D.19)."""

    title = "Characterisation of the material"

    def blocks(self, result: RunResult) -> Iterator[Block]:
        """Return lines, relaxations and settling times; nothing where the recipe characterises no material."""
        material = result.characterisation
        if material is None:
            return
        from cbsr_qa.report.draw.characterisation import lines_figure, relaxations_figure, settling_by_strain_figure

        words = _describe_material(material)
        yield Paragraph(words)
        yield from (Paragraph(f"No material file may be issued: {why}.", "warning") for why in material.refused)
        yield Figure(
            "Steady change of conductance of every cycle (dots), mean and standard deviation by strain, line and its"
            " 95 % band. Open: left out of the line. Above: between the pins, as the paper has it (its Fig 5). Below:"
            " under the head alone; its band has what is assumed of the pins' contacts.",
            words,
            lines_figure(material),
        )
        yield from (_parameters(material), _strains(material.levels))
        yield from _cycles(result.record)
        yield Figure(
            "Mean trace of every strain (dots) and its fit (line), from the level before the press and without what"
            " earlier presses left. Red tick: settled.",
            "Relaxation after press and release at every strain, with fits.",
            relaxations_figure(material),
        )
        yield Figure(
            "Settling time by strain with its standard error: after the press (filled) and after the release (open)."
            " Line and band: one fit to all strains. Triangle: a lower bound.",
            _describe_settling(material.settlings),
            settling_by_strain_figure(material),
        )
        yield from (_settlings(material), _kernels(material), Paragraph(_describe_assumptions(material), "note"))


def _describe_material(material: Characterisation) -> str:
    apparent, local = material.against_strain.line, material.local_against_strain.line
    used = [level.cycles for level in material.levels if not level.why]
    words = f"{plural(sum(used), 'cycle')} at {plural(len(used), 'strain')} were used."
    if apparent is not None and local is not None:
        under = parameter_text(local.slope)
        words += f" The gauge factor is {parameter_text(apparent.slope)} between the pins and {under} under the head."
    if (modulus := material.modulus_kPa) is not None:
        words += f" The relaxed modulus is {quantity(modulus.value, 'kPa', modulus.stderr)}."
    return words + "".join(f" Left out: {level.why}." for level in material.levels if level.why)


def _parameters(material: Characterisation) -> Table:
    strain = material.against_strain, material.local_against_strain
    stress = material.against_stress, material.local_against_stress
    lines = (
        ("α against strain (gauge factor)", strain, "slope"),
        ("β against strain", strain, "intercept"),
        ("α against stress [1/kPa]", stress, "slope"),
        ("β against stress", stress, "intercept"),
    )
    rows = [[name, *(_format_parameter(line, which) for line in pair)] for name, pair, which in lines]
    before, rested = (_format_parameter(line, "slope") for line in material.end_of_hold)
    rows.append(["gauge factor as read at the end of holds, from before the press", before, "–"])
    rows.append(["the same, from the rested strip", rested, "–"])
    caption = "Δρ/ρ₀ = α x + β (paper Eqs 1 and 2), one standard error."
    return text_table(caption, ("Parameter", "Between the pins", "Under the head"), rows, (1, 2))


def _format_parameter(fitted: FittedLine, which: str) -> str:
    return format_or_dash(
        fitted.line, lambda line: parameter_text(line.slope if which == "slope" else line.intercept)
    )


def _strains(levels: Sequence[StrainLevel]) -> Table:
    rows = [
        [
            f"{100 * level.strain:g}",
            str(level.cycles),
            format_or_dash(level.stress_kPa, lambda stress: number(stress, 4)),
            with_uncertainty(100 * level.mean, 100 * level.deviation),
            with_uncertainty(100 * level.local_mean, 100 * level.local_deviation),
            level.why or "used",
        ]
        for level in levels
    ]
    columns = ("Strain [%]", "Cycles", "Stress [kPa]", "Between the pins [%]", "Under the head [%]", "Line")
    caption = "Steady change of conductance by strain: mean ± standard deviation over the cycles."
    return text_table(caption, columns, rows, (0, 1, 2, 3, 4))


def _cycles(record: RunRecord) -> list[Figure]:
    """Cycles of one strain as they were read (paper: Fig 6)."""
    phase = next((p for p in record.phases if p.role is Role.CHARACTERISATION and p.loads), None)
    if phase is None or phase.frames is None or not phase.frames.current_A:
        return []
    strains = sorted({load.load.strain for load in phase.loads})
    strain = min(strains, key=lambda strain: abs(strain - _SHOWN_STRAIN))
    loads = [load for load in phase.loads if load.load.strain == strain]
    start_s, end_s = loads[0].press_start_s - _BEFORE_S, loads[-1].rest_end_s
    caption = f"{plural(len(loads), 'cycle')} of {100 * strain:g} % strain, as they were read."
    traces = _traces(phase, phase.frames, record.indenter.area_mm2, start_s, end_s)
    return [Figure(caption, caption, timeline_figure(traces, [], time_label="time since their first press [s]"))]


def _traces(phase: PhaseRecord, frames: FrameBlock, area_mm2: float, start_s: float, end_s: float) -> list[Trace]:
    """Resistance, and stress if the force was recorded, against the time since the first press."""
    frames_shown, zero_s = frames.select_interval(start_s, end_s), start_s + _BEFORE_S
    ohm = frames_shown.voltages[:, 0, 0] / (frames_shown.current_A or 1.0)
    traces = [Trace("resistance", "kΩ", np.array(frames_shown.time_s) - zero_s, 1e-3 * ohm)]
    force = phase.channel("force")
    if force is not None:
        samples = force.select_interval(start_s, end_s)
        traces.append(Trace("stress", "kPa", samples.time_s - zero_s, 1e3 * samples.values / area_mm2))
    return traces


def _settlings(material: Characterisation) -> Table:
    strains = [level.strain for level in material.levels]
    columns = ("Strain [%]", "Conductance, press [s]", "Conductance, release [s]", "Stress, press [s]")
    groups = (("conductance", True), ("conductance", False), ("stress", True))
    rows = [
        [
            "all" if strain is None else f"{100 * strain:g}",
            *(_time(material, signal, way, strain) for signal, way in groups),
        ]
        for strain in (*strains, None)
    ]
    caption = (
        f"Settling to ± {100 * material.settings.settling_tolerance:g} %, of one fit to the cycles of a strain; ≥: a"
        " lower bound."
    )
    return text_table(caption, columns, rows, (0, 1, 2, 3))


def _time(material: Characterisation, signal: str, loading: bool, strain: float | None) -> str:
    key = (signal, loading, strain)
    settling = next((o for o in material.settlings if (o.signal, o.loading, o.strain) == key), None)
    if settling is None or settling.settling.value_s is None:
        return "–"
    text = with_uncertainty(settling.settling.value_s, settling.stderr_s)
    return f"≥ {text}" if settling.settling.censored else text


def _describe_settling(settlings: Sequence[StrainSettling]) -> str:
    settled = [
        f"{settling.words} {'at least ' if settling.settling.censored else ''}{settling.settling.value_s:.3g} s"
        for settling in settlings
        if settling.strain is None and settling.settling.value_s is not None
    ]
    return f"All strains together: {'; '.join(settled)}." if settled else "No settling time could be determined."


def _kernels(material: Characterisation) -> Table:
    kernels = (
        ("conductance after a press", material.loading),
        ("conductance after a release", material.unloading),
        ("stress", material.stress),
    )
    rows = []
    for name, kernel in kernels:
        cells = ["–"] * 4
        if kernel is not None:
            pairs = zip(kernel.weights, kernel.time_constants_s, strict=True)
            cells = [text for weight, tau_s in pairs for text in (number(weight), number(tau_s))]
        rows.append([name, *cells])
    columns = ("Response to a unit step", "w₁", "τ₁ [s]", "w₂", "τ₂ [s]")
    return text_table("1 + w₁ exp(−t/τ₁) + w₂ exp(−t/τ₂), corrected for the ramps.", columns, rows, (1, 2, 3, 4))


def _describe_assumptions(material: Characterisation) -> str:
    strip, settings = material.strip, material.settings
    parts = dict(material.local_against_strain.parts)
    contacts = parts.get("contacts of the pins")
    words = (
        f"A small change under the head shows between the pins as {100 * strip.head_share:.3g} % of itself: the rest"
        " of the strip and the pins' contacts lie in series. That share is the forward model's. Two pins say nothing"
        f" of their contacts: {settings.contact_length_mm:g} ± {settings.contact_length_stderr_mm:g} mm times the"
        f" sheet resistance is assumed, {100 * strip.contact_share:.2g} % of the resistance between the pins."
    )
    if contacts is not None:
        words += f" Of the standard error of the gauge factor under the head, {contacts:.2g} come from there."
    return f"{words} Errors of the load cell, of the strain and of the strip's dimensions are not in any of them."
