"""The material file that a characterisation issues."""

from dataclasses import replace
from pathlib import Path
from typing import Final

from cbsr_qa.config.material import material_text
from cbsr_qa.config.paths import materials_folder
from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.plan.limits import Outcome
from cbsr_qa.domain.results.characterisation import Characterisation
from cbsr_qa.domain.results.run_result import RunResult
from cbsr_qa.domain.sensor.sensor_type import Material, Parameter
from cbsr_qa.report.render import report_name, write_report

_LONGEST_NAME: Final = 64  # of a material


def why_no_material(result: RunResult) -> str:
    """Return why a run issues no material file; empty if it does."""
    characterised = result.characterisation
    if characterised is None:
        return "nothing was characterised"
    if characterised.refused:
        return characterised.refused[0]
    if result.verdict.outcome not in (Outcome.PASS, Outcome.MARGINAL):
        return f"the run did not pass: {result.verdict.reason}"
    return ""


def material_path(result: RunResult) -> Path:
    """Return the path of a run's material file, named after its batch, or its serial number if it has none."""
    identity = result.record.identity
    name = report_name(identity.sensor.batch or identity.sensor.serial, identity.run)
    return materials_folder() / Path(name).with_suffix(".toml")


def write_material(result: RunResult) -> Path:
    """Write the material file of a run whole or not at all. Raise RefusedError if the folder cannot be written to."""
    path = material_path(result)
    write_report(path, material_text(material_of(result), _comments(result)))
    return path


def material_of(result: RunResult) -> Material:
    """Return the characterised material, with the lines against stress and strain *under the head*.

    Noise is not a property of the material: it is copied from the configured material.

    Raises
    ------
    NumericsError
        If the characterisation was refused.
    """
    characterised, identity = result.characterisation, result.record.identity
    if characterised is None or characterised.refused:
        raise NumericsError(f"run {identity.run} characterised no material: {why_no_material(result)}")
    strain, stress = characterised.local_against_strain.line, characterised.local_against_stress.line
    kernels = characterised.loading, characterised.unloading, characterised.stress
    assert strain is not None
    assert stress is not None
    assert characterised.modulus_kPa is not None
    loading, unloading, relaxation = (kernel for kernel in kernels if kernel is not None)
    noise = result.record.material.relative_noise
    carried = (
        f"taken over from {result.record.material.name}, because a strip with two pins cannot show it; {noise.source}"
    )
    return Material(
        name=(identity.sensor.batch or identity.sensor.serial)[:_LONGEST_NAME],
        interelectrode_resistance_ohm=_resistance(characterised),
        modulus_kPa=characterised.modulus_kPa,
        against_stress=stress,
        against_strain=strain,
        stress_relaxation=relaxation,
        loading_relaxation=loading,
        unloading_relaxation=unloading,
        relative_noise=Parameter(noise.value, noise.stderr, carried[:1000]),
        strip_relaxation=characterised.relaxation,
    )


def _resistance(characterised: Characterisation) -> Parameter:
    resistance, squares = characterised.strip.resistance_ohm, characterised.strip.squares
    source = (
        f"{resistance.source}; between the strip's two pins, {squares:.4g} squares of"
        f" {resistance.value / squares:.5g} ohm: neighbours on another sensor type have another"
    )
    return replace(resistance, source=source)


def _range(characterised: Characterisation) -> str:
    """State the strains and stresses for which the lines hold."""
    kept_levels = [level for level in characterised.levels if not level.why]
    least_strain = max(min(level.strain for level in kept_levels), characterised.lowest_strain or 0.0)
    highest = max(kept_levels, key=lambda level: level.strain)
    stress = "" if highest.stress_kPa is None else f", up to {highest.stress_kPa:.3g} kPa"
    return f"Characterised from {100 * least_strain:g} to {100 * highest.strain:g} % strain{stress}."


def _comments(result: RunResult) -> list[str]:
    """Return comments for a reader of the file."""
    characterised, identity = result.characterisation, result.record.identity
    assert characterised is not None
    lines = [
        f"Characterised in run {identity.run} at station {identity.station}, {identity.started_at.date()}: strip"
        f" {identity.sensor.serial}, batch {identity.sensor.batch or 'not stated'}.",
        "against_strain and against_stress are local: relative conductance changes under the head, by the forward",
        f"model of the strip with contacts of {characterised.settings.contact_length_mm:g} ±"
        f" {characterised.settings.contact_length_stderr_mm:g} mm (assumed: two pins cannot show them).",
    ]
    if characterised.against_strain.line is not None:
        slope = characterised.against_strain.line.slope
        lines.append(
            f"Between the pins, as the paper has it, the gauge factor is {slope.value:.4g} ± {slope.stderr or 0:.2g}."
        )
    lines.append(f"{_range(characterised)} Standard errors are statistical, with that of the contacts.")
    lines += [f"Simulated: {remark}." for remark in identity.simulated]
    lines += [f"Reduced: {' '.join(remark.split())}." for remark in characterised.reduced]
    return lines
