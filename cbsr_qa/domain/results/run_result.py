"""A run with all its results."""

from dataclasses import dataclass, field

from cbsr_qa.domain.plan.limits import FailureCode, LimitsVersion, Outcome, select_failure_codes
from cbsr_qa.domain.results.calibration import Calibration
from cbsr_qa.domain.results.characterisation import Characterisation
from cbsr_qa.domain.results.charts import StationCharts
from cbsr_qa.domain.results.measurement import Measurement, Verdict, relative_margin
from cbsr_qa.domain.results.observation import RunObservation
from cbsr_qa.domain.run.changes import ChangeHistory, SensorHistory, VerdictOverride
from cbsr_qa.domain.run.run import RunRecord
from cbsr_qa.domain.run.station import StationCheck


@dataclass(frozen=True, slots=True, eq=False)
class RunResult:
    """A run with all its results: the input of a report section.

    Parameters
    ----------
    observation : None where the run ended before anything could be analysed.
    calibration : None if not issued; ``calibration_why`` then gives the reason.
    compute_s : seconds of computing by stage.
    limits_version : version of those limits that carry one.
    characterisation : characterisation of the material, where the recipe is for that; there is no observation then.
    station_check : the station's latest one when the run began; None if never checked.
    station_charts : state of the station's control charts with this run; None without a reference.
    history : changes of the run's files since its sensor type last passed its recipe.
    overrides : decisions against the verdicts of the run, oldest first; ``verdict`` is not changed.
    sensor_history : runs of the sensor that began before this one; None if not loaded.
    missing : whether the run has no stored result; the verdict is then "not measured".
    coded : all failure codes of the run's own recipe, also where another one was adopted.
    failed_before : codes of earlier failures of the sensor and recipe, as often as each was given.
    """

    record: RunRecord
    observation: RunObservation | None
    measurements: tuple[Measurement, ...]
    verdict: Verdict
    calibration: Calibration | None
    calibration_why: str
    compute_s: tuple[tuple[str, float], ...] = ()
    warnings: tuple[str, ...] = field(default=())
    limits_version: LimitsVersion | None = None
    characterisation: Characterisation | None = None
    station_check: StationCheck | None = None
    station_charts: StationCharts | None = None
    history: ChangeHistory = field(default_factory=ChangeHistory)
    overrides: tuple[VerdictOverride, ...] = ()
    sensor_history: SensorHistory | None = None
    missing: bool = False
    coded: tuple[FailureCode, ...] = ()
    failed_before: tuple[str, ...] = ()

    @property
    def calibration_words(self) -> str:
        """Why no calibration was issued, without the reason that the verdict or the end of the run states."""
        words = self.calibration_why
        for stated in filter(None, (self.record.end_detail, self.verdict.reason)):
            words = words.removesuffix(f": {stated}")
        return words

    @property
    def failure_codes(self) -> tuple[FailureCode, ...]:
        """Codes of what the run failed, the worst first, whether the verdict was overridden or not."""
        outcome, end = None if self.missing else self.verdict.outcome, str(self.record.end)
        failed = sorted((m for m in self.measurements if m.outcome is Outcome.FAIL), key=relative_margin)
        return select_failure_codes(self.coded, outcome, end, [m.limit_key for m in failed], self.failed_before)

    def codes_of(self, measurement: Measurement) -> tuple[FailureCode, ...]:
        """Return the code of a failed measurement, as a tuple of one; empty for others and where it has none."""
        failed = measurement.outcome if measurement.outcome is Outcome.FAIL else None
        return select_failure_codes(self.coded, failed, "", [measurement.limit_key], self.failed_before)
