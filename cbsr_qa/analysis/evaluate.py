"""Evaluation of a stored run: observations, judged measurements, verdict, calibration."""

from dataclasses import dataclass

from cbsr_qa.analysis.measure import judge, measure_run
from cbsr_qa.analysis.run import observe_run, run_force
from cbsr_qa.analysis.strip_cycles import characterise_run
from cbsr_qa.analysis.strip_measurements import measure_characterisation
from cbsr_qa.calibration import issue_calibration
from cbsr_qa.domain import CalibrationError, CbsrError, NumericsError
from cbsr_qa.domain.plan import Recipe
from cbsr_qa.domain.results import (
    Calibration,
    Characterisation,
    CharacterisationSettings,
    EndReason,
    Limit,
    Measurement,
    Outcome,
    RunObservation,
    Verdict,
    decide,
)
from cbsr_qa.domain.run import RunRecord
from cbsr_qa.plugin import Kind, Plugins, failure, made
from cbsr_qa.system import Stages


@dataclass(frozen=True, slots=True, eq=False)
class Conclusion:
    """Results of a run's analysis.

    Parameters
    ----------
    observation : None where the run could not be analysed; the verdict then says why.
    measurements : judged.
    warnings : in plain words, those of the observation included.
    characterisation : of a material, where the recipe is for that: nothing was imaged then.
    """

    observation: RunObservation | None
    measurements: tuple[Measurement, ...]
    verdict: Verdict
    warnings: tuple[str, ...]
    characterisation: Characterisation | None = None


def conclude(record: RunRecord, recipe: Recipe, plugins: Plugins, stages: Stages) -> Conclusion:
    """Analyse and judge a stored run.

    Parameters
    ----------
    record : as loaded from the store; nothing else is looked at.
    recipe : says how to image, what to measure and what is allowed.
    stages : told and timed.

    Returns
    -------
    A conclusion whatever the run was: one that did not finish, or cannot be imaged, is "not measured" and why.

    Raises
    ------
    PluginError, ConfigError
        If the recipe's reconstruction or a metric is unknown or refuses its options.
    """
    if record.end is not EndReason.FINISHED:
        why = f"the run was {record.end}: {record.end_detail}".removesuffix(": ")
        return Conclusion(None, (), Verdict(Outcome.NOT_MEASURED, why), ())
    if recipe.characterisation is not None:
        return _characterised(record, recipe.characterisation, recipe.limits, stages)
    reconstruction = made(plugins, Kind.RECONSTRUCTION, recipe.reconstruction, "[reconstruction]")
    metrics = {choice.name: made(plugins, Kind.METRIC, choice, "[metrics]") for choice in recipe.metrics}
    try:
        with stages.stage("imaging"):
            observation = observe_run(record, reconstruction, recipe.analysis)
    except BaseException as error:  # noqa: BLE001 - a stranger's reconstruction may raise anything, and the run is stored
        why = f"the frames cannot be imaged: {failure(error)}"
        remedy = error.remedy if isinstance(error, CbsrError) else ""
        return Conclusion(None, (), Verdict(Outcome.NOT_MEASURED, why), (remedy,) if remedy else ())
    with stages.stage("metrics"):
        measured, failed = measure_run(observation, metrics)
        judged = judge(measured, recipe.limits)
    return Conclusion(observation, judged, decide(judged), (*observation.warnings, *failed))


def _characterised(
    record: RunRecord, settings: CharacterisationSettings, limits: tuple[Limit, ...], stages: Stages
) -> Conclusion:
    """Evaluate a run on a strip: from press cycles to its material, without an image."""
    try:
        with stages.stage("characterising the material"):
            material = characterise_run(record, settings)
    except NumericsError as error:
        why = f"the material cannot be characterised: {error.reason}"
        return Conclusion(None, (), Verdict(Outcome.NOT_MEASURED, why), (error.remedy,) if error.remedy else ())
    judged = judge(measure_characterisation(material), limits)
    return Conclusion(None, judged, decide(judged), (*material.refused, *material.reduced), material)


def calibrated(
    conclusion: Conclusion, recipe: Recipe, *, calibration: str, issued_at: str
) -> tuple[Calibration | None, str]:
    """Create the calibration of a run that passed.

    Parameters
    ----------
    calibration, issued_at : identity and time of issue.

    Returns
    -------
    The calibration and an empty reason, or None and why there is none.
    """
    if recipe.characterisation is not None:
        return None, "a material strip gets no calibration"
    if conclusion.observation is None:
        return None, conclusion.verdict.reason
    if not recipe.calibrate_phases:
        return None, f"the recipe {recipe.name!r} has no phase to calibrate from"
    force = run_force(conclusion.observation)
    try:
        issued = issue_calibration(
            conclusion.observation,
            conclusion.verdict,
            calibration=calibration,
            issued_at=issued_at,
            phases=recipe.calibrate_phases,
            overlap_threshold=_overlap_threshold(recipe),
            noise_figure=_measured(conclusion, "noise_figure"),
            learned=force.learned,
            learned_from=force.used,
            confirmed=force.confirmed(),
            no_force=force.why,
        )
    except (CalibrationError, NumericsError) as error:
        return None, error.reason
    return issued, ""


def _overlap_threshold(recipe: Recipe) -> float:
    """Lowest area overlap that the recipe accepts where it calibrates, with its mask.

    A recipe without such a limit accepts what its bands do not call their worst; with one band, anything.
    """
    given = [
        limit.lower
        for limit in recipe.limits
        if limit.measurement == "area_overlap"
        and limit.lower is not None
        and not limit.qualifier
        and limit.phase in ("", *recipe.calibrate_phases)
    ]
    bands = sorted(band.lower for band in recipe.analysis.overlap_bands)
    return max(given) if given else bands[min(1, len(bands) - 1)]


def _measured(conclusion: Conclusion, name: str) -> float | None:
    return next((m.value for m in conclusion.measurements if m.name == name and m.value is not None), None)
