"""Evaluation of a stored run: observations, judged measurements, verdict, calibration."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

from cbsr_qa.analysis.answers import validate_answer
from cbsr_qa.analysis.run.force import run_force
from cbsr_qa.analysis.run.observe import observe_run
from cbsr_qa.analysis.run.place import run_place
from cbsr_qa.calibration.force.validity import batch_words
from cbsr_qa.calibration.issue import issue_calibration
from cbsr_qa.domain.errors import CalibrationError, CbsrError, NumericsError
from cbsr_qa.domain.plan.analysis_settings import CharacterisationSettings
from cbsr_qa.domain.plan.limits import SEVERITY, Limit, Outcome
from cbsr_qa.domain.plan.plan import Recipe
from cbsr_qa.domain.plan.standards import ReferenceStandard
from cbsr_qa.domain.results.calibration import Calibration
from cbsr_qa.domain.results.characterisation import Characterisation
from cbsr_qa.domain.results.dimensions import Dimensions
from cbsr_qa.domain.results.measurement import Measurement, Verdict, decide
from cbsr_qa.domain.results.observation import LoadObservation, RunObservation
from cbsr_qa.domain.run.run import RunRecord
from cbsr_qa.domain.run.states import EndReason
from cbsr_qa.plugin.creation import create_plugin
from cbsr_qa.plugin.discovery import Plugins
from cbsr_qa.plugin.failures import failure
from cbsr_qa.plugin.hooks import Kind
from cbsr_qa.plugin.interfaces import LoadMetric, RunMetric
from cbsr_qa.system.clock import Stages
from cbsr_qa.system.copies import end_forked_copies


@dataclass(frozen=True, slots=True, eq=False)
class Conclusion:
    """Results of a run's analysis.

    Parameters
    ----------
    observation : None if the run could not be analysed; the verdict then gives the reason.
    warnings : including those of the observation.
    characterisation : characterisation of a material, if the recipe requests it; nothing was imaged then.
    """

    observation: RunObservation | None
    measurements: tuple[Measurement, ...]
    verdict: Verdict
    warnings: tuple[str, ...]
    characterisation: Characterisation | None = None


def evaluate_run(
    record: RunRecord,
    recipe: Recipe,
    plugins: Plugins,
    stages: Stages,
    *,
    standards: Sequence[ReferenceStandard] = (),
) -> Conclusion:
    """Analyse and judge a stored run.

    Parameters
    ----------
    record : record as loaded from the store.
    recipe : says how to image, what to measure and what is allowed.
    stages : progress and timing.
    standards : reference standards that the run's station states, as stored with it.

    Returns
    -------
    A conclusion in any case: a run that did not finish, or cannot be imaged, is "not measured", with the reason.

    Raises
    ------
    PluginError, ConfigError
        If the recipe's reconstruction or a metric is unknown or refuses its options.
    """
    if record.end is not EndReason.FINISHED:
        reason = f"the run was {record.end}: {record.end_detail}".removesuffix(": ")
        return _empty_conclusion(reason)
    if recipe.characterisation is not None:
        return _evaluate_strip(record, recipe.characterisation, recipe.limits, stages)
    reconstruction = create_plugin(plugins, Kind.RECONSTRUCTION, recipe.reconstruction, "[reconstruction]")
    metrics = {choice.name: create_plugin(plugins, Kind.METRIC, choice, "[metrics]") for choice in recipe.metrics}
    try:
        with stages.stage("imaging"), end_forked_copies():
            observation = observe_run(record, reconstruction, recipe.analysis)
            observation = replace(observation, standards=tuple(standards))
    except BaseException as error:  # noqa: BLE001 - a plugin may raise anything, and the run is stored
        remedy = error.remedy if isinstance(error, CbsrError) else ""
        return _empty_conclusion(f"the frames cannot be imaged: {failure(error)}", remedy)
    with stages.stage("metrics"):
        measured, failed_metrics = measure_run(observation, metrics)
        judged = judge(measured, recipe.limits)
    if recipe.analysis.learn_place:
        with stages.stage("learning the place"):
            run_place(observation)
    warnings = (*observation.warnings, *_warn_unlike(observation), *failed_metrics)
    return Conclusion(observation, judged, decide(judged), warnings)


def _warn_unlike(run: RunObservation) -> Iterator[str]:
    """Yield a warning if the sensor is not like the batch that its recipe takes as prior."""
    learned = run_force(run).learned if run.settings.prior == "batch" else None
    if learned is not None and learned.model.batch is not None and not learned.model.batch.alike:
        yield batch_words(learned.model.batch)


def _empty_conclusion(why: str, remedy: str = "") -> Conclusion:
    return Conclusion(None, (), Verdict(Outcome.NOT_MEASURED, why), (remedy,) if remedy else ())


def _evaluate_strip(
    record: RunRecord, settings: CharacterisationSettings, limits: tuple[Limit, ...], stages: Stages
) -> Conclusion:
    """Evaluate a run on a strip: from press cycles to its material, without an image."""
    from cbsr_qa.analysis.strip_cycles import characterise_run  # loads what no other run needs
    from cbsr_qa.analysis.strip_measurements import measure_characterisation

    try:
        with stages.stage("characterising the material"):
            material = characterise_run(record, settings)
    except NumericsError as error:
        return _empty_conclusion(f"the material cannot be characterised: {error.reason}", error.remedy)
    judged = judge(measure_characterisation(material), limits)
    return Conclusion(None, judged, decide(judged), (*material.refused, *material.reduced), material)


def calibrate_run(
    conclusion: Conclusion,
    recipe: Recipe,
    *,
    calibration: str,
    issued_at: str,
    standards: Sequence[ReferenceStandard] = (),
) -> tuple[Calibration | None, str]:
    """Return the calibration of a run that passed and an empty reason, or None and the reason.

    Parameters
    ----------
    calibration, issued_at : identity and time of issue.
    standards : reference standards that the station states.
    """
    if recipe.characterisation is not None:
        return None, "a material strip gets no calibration"
    if conclusion.observation is None:
        return None, conclusion.verdict.reason
    if not recipe.calibrate_phases:
        return None, f"the recipe {recipe.name!r} has no phase to calibrate from"
    force = run_force(conclusion.observation)
    noise_figures = (m.value for m in conclusion.measurements if m.name == "noise_figure" and m.value is not None)
    try:
        issued = issue_calibration(
            conclusion.observation,
            conclusion.verdict,
            calibration=calibration,
            issued_at=issued_at,
            phases=recipe.calibrate_phases,
            overlap_threshold=_overlap_threshold(recipe),
            noise_figure=next(noise_figures, None),
            learned=force.learned,
            learned_from=force.used,
            confirmed=force.list_confirmed_loads(),
            no_force=force.why,
            place=run_place(conclusion.observation).used,
            standards=standards,
        )
    except (CalibrationError, NumericsError) as error:
        return None, error.reason
    return issued, ""


def _overlap_threshold(recipe: Recipe) -> float:
    """Lowest area overlap that the recipe accepts where it calibrates, with its mask.

    Without such a limit, all but the worst of the recipe's bands are accepted; with one band, anything.
    """
    overlap_limits = [
        limit.lower
        for limit in recipe.limits
        if limit.measurement == "area_overlap"
        and limit.lower is not None
        and not limit.qualifier
        and limit.phase in ("", *recipe.calibrate_phases)
    ]
    bands = sorted(band.lower for band in recipe.analysis.overlap_bands)
    return max(overlap_limits) if overlap_limits else bands[min(1, len(bands) - 1)]


def measure_run(
    observation: RunObservation, metrics: Mapping[str, LoadMetric | RunMetric]
) -> tuple[tuple[Measurement, ...], tuple[str, ...]]:
    """Call every metric; last those that need the run's force, which a helper learns meanwhile.

    Parameters
    ----------
    metrics : plugin name → object, in the recipe's order.

    Returns
    -------
    The measurements in that order, and a warning for every metric that raised or returned anything but measurements;
    the others are unaffected, and a limit on it finds nothing measured.
    """
    measurements_by_metric: dict[str, list[Measurement]] = {}
    failure_by_metric: dict[str, str] = {}
    for name in sorted(metrics, key=lambda name: getattr(type(metrics[name]), "needs_force", False) is True):
        try:
            with end_forked_copies():
                measurements_by_metric[name] = ask(metrics[name], observation)
        except BaseException as error:  # noqa: BLE001 - a plugin's code may raise anything
            failure_by_metric[name] = f"metric {name} failed and measured nothing: {failure(error)}"
    measured = tuple(measurement for name in metrics for measurement in measurements_by_metric.get(name, ()))
    return measured, tuple(failure_by_metric[name] for name in metrics if name in failure_by_metric)


#: Reason stated by a measurement that only shows that a limit found nothing to judge.
_NOT_ENABLED: Final = "no metric of this recipe measures it: enable one, or remove the limit"
_OTHER_UNIT: Final = "the limit is in "


def judge(measurements: Iterable[Measurement], limits: Iterable[Limit]) -> tuple[Measurement, ...]:
    """Judge measurements by limits; if several limits match one measurement, the strictest outcome counts.

    Returns
    -------
    Every measurement, judged if a limit fits, and one without value for each limit that found nothing to judge, or
    only another unit (a limit in µm does not judge millimetres).
    """
    judged = list(measurements)
    for limit in limits:
        fitting = [number for number, measurement in enumerate(judged) if _applies_to(limit, measurement)]
        same_unit = [number for number in fitting if judged[number].unit == limit.unit]
        for number in same_unit:
            again = judged[number].judge(limit)
            if SEVERITY.index(again.outcome) <= SEVERITY.index(judged[number].outcome):
                judged[number] = again
        if not fitting:
            judged.append(_make_missing_measurement(limit, _NOT_ENABLED))
        elif not same_unit:
            unit = judged[fitting[0]].unit
            judged.append(_make_missing_measurement(limit, f"{_OTHER_UNIT}{limit.unit}, the measurement in {unit}"))
    return tuple(judged)


def judge_again(judged: Iterable[Measurement], limits: Iterable[Limit]) -> tuple[Measurement, ...]:
    """Judge measurements by other limits than those they were judged by."""
    own_measurements = (
        measurement
        for measurement in judged
        if not (measurement.how == _NOT_ENABLED or measurement.how.startswith(_OTHER_UNIT))
    )
    return judge(
        (replace(measurement, limit=None, outcome=Outcome.NOT_JUDGED) for measurement in own_measurements), limits
    )


def ask(metric: LoadMetric | RunMetric, observation: RunObservation) -> list[Measurement]:
    """Call one metric for every load and the whole run; raises what :func:`validate_answer` and the metric raise."""
    measurements: list[Measurement] = []
    if isinstance(metric, LoadMetric):
        for load in observation.loads:
            measurements += validate_answer(metric.measure_load(load, observation))
            if load.alternate is not None:
                measurements += _measure_other_reference(metric, load.alternate, observation)
    if isinstance(metric, RunMetric):
        measurements += validate_answer(metric.measure_run(observation))
    return measurements


def _measure_other_reference(metric: LoadMetric, load: LoadObservation, run: RunObservation) -> list[Measurement]:
    """Measure a load relative to the reference that the recipe did not choose; reported, never judged."""
    reference = "before the press" if run.settings.reference == "run" else "unloaded run"
    return [
        replace(m, qualifier=", ".join(filter(None, (m.qualifier, Dimensions(reference=reference).text))))
        for m in validate_answer(metric.measure_load(load, run))
    ]


def _applies_to(limit: Limit, measurement: Measurement) -> bool:
    return (
        limit.measurement == measurement.name
        and limit.phase in ("", measurement.phase)
        and limit.qualifier == measurement.qualifier
    )


def _make_missing_measurement(limit: Limit, why: str) -> Measurement:
    nothing = Measurement(limit.measurement, None, limit.unit, phase=limit.phase, qualifier=limit.qualifier, how=why)
    return nothing.judge(limit)
