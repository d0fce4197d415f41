"""Loads that a calibration was not learned from: the force that the calibrated sensor indicates, and its error."""

from collections.abc import Iterator
from dataclasses import dataclass
from math import hypot, isfinite
from typing import Final

from cbsr_qa.analysis.defects.load_cell import describe_cell_limit
from cbsr_qa.analysis.run.loads import list_neighbours, load_window, mean_force
from cbsr_qa.calibration.runtime.calibration import Calibration
from cbsr_qa.calibration.uncertainty.budget import evaluate_forces
from cbsr_qa.domain.errors import CalibrationError
from cbsr_qa.domain.plan.plan import CertificateSettings, Recipe
from cbsr_qa.domain.plan.steps import Role
from cbsr_qa.domain.readings.loads import LoadRecord
from cbsr_qa.domain.results.certificate import CheckedLoad
from cbsr_qa.domain.run.run import PhaseRecord, RunRecord
from cbsr_qa.stats.conformity import decide_error

#: Phases that press all over the sheet: presses repeated at one place do not represent it.
_ROLES: Final = (Role.GRID, Role.RANDOM)


@dataclass(frozen=True, slots=True)
class _Reading:
    phase: str
    place_mm: tuple[float, float]
    reference_N: float
    indicated_N: float


def check_loads(
    record: RunRecord, recipe: Recipe, calibration: Calibration, settings: CertificateSettings | None
) -> tuple[CheckedLoad, ...]:
    """Return the held-out loads within the calibration's range, judged by the laboratory's requirement, if any.

    All of them count, whether or not the calibration agrees with them.

    Parameters
    ----------
    settings : requirement and decision rule; None: the loads are not judged.

    Raises
    ------
    CalibrationError
        If the uncertainty of a force cannot be evaluated, or the calibration tells none of such a load.
    """
    return tuple(
        _judge_load(reading, calibration, settings)
        for phase in list_held_out(record, recipe)
        for reading in _read_loads(phase, record, recipe, calibration)
    )


def list_held_out(record: RunRecord, recipe: Recipe) -> list[PhaseRecord]:
    """Return the phases with loads all over the sheet that the calibration was not learned from."""
    return [phase for phase in record.phases if phase.role in _ROLES and phase.name not in recipe.calibrate_phases]


def _read_loads(
    phase: PhaseRecord, record: RunRecord, recipe: Recipe, calibration: Calibration
) -> Iterator[_Reading]:
    """Yield loads that were pressed alone, with their force recorded, within the calibration's range."""
    validity = calibration.issued.validity
    assert validity.force_N is not None
    lowest_N, highest_N = validity.force_N
    for load in phase.loads:
        window = load_window(phase, load, recipe.analysis)
        last = window.steady.select(slice(len(window.steady) - 1, None))  # U is that of one frame
        samples = phase.channel("force")
        reference_N, _ = mean_force(samples, last, load)
        if reference_N is None or describe_cell_limit(samples, load) or _has_neighbours(phase, load, record):
            continue
        place_mm = load.load.x_mm, load.load.y_mm
        if not (lowest_N <= reference_N <= highest_N and hypot(*place_mm) <= validity.radius_mm):
            continue
        (indicated_N,) = calibration.force(last.voltages, place_mm=place_mm).force_N.tolist()
        if not isfinite(indicated_N):
            raise CalibrationError(
                f"the calibration tells no force of load {load.load.label} of phase {phase.name!r}, within its range"
            )
        yield _Reading(phase.name, place_mm, reference_N, indicated_N)


def _has_neighbours(phase: PhaseRecord, load: LoadRecord, record: RunRecord) -> bool:
    return bool(list_neighbours(record.indenter, phase, load, load.release_start_s - 1e-6))


def _judge_load(reading: _Reading, calibration: Calibration, settings: CertificateSettings | None) -> CheckedLoad:
    (expanded,) = evaluate_forces(calibration.issued, [reading.reference_N], [reading.place_mm])
    if settings is None or not settings.judges:
        return CheckedLoad(reading.phase, reading.reference_N, reading.indicated_N, expanded)
    maximum_N = settings.max_error_of(reading.reference_N)
    decision = decide_error(
        reading.indicated_N - reading.reference_N,
        maximum_N,
        expanded.U_N if settings.decision == "guarded" else 0.0,
        expanded.standard_uncertainty_N,
        expanded.dof,
    )
    return CheckedLoad(
        reading.phase,
        reading.reference_N,
        reading.indicated_N,
        expanded,
        maximum_N,
        str(decision.outcome),
        decision.conformance,
    )
