"""Loads that a calibration was not learned from: the force that the calibrated sensor indicates, and its error."""

from collections.abc import Iterator
from dataclasses import dataclass
from math import isfinite
from typing import Final

import numpy as np

from cbsr_qa.analysis.defects.load_cell import describe_cell_limit
from cbsr_qa.analysis.run.loads import list_neighbours, load_window, mean_force, select_forces
from cbsr_qa.calibration.runtime.calibration import Calibration
from cbsr_qa.calibration.uncertainty.budget import ReferencePress, evaluate_errors
from cbsr_qa.domain.errors import CalibrationError
from cbsr_qa.domain.plan.plan import CertificateSettings, Recipe
from cbsr_qa.domain.plan.steps import Role
from cbsr_qa.domain.readings.loads import LoadRecord
from cbsr_qa.domain.results.calibration import Validity
from cbsr_qa.domain.results.certificate import CheckedLoad, LeftOutLoad
from cbsr_qa.domain.results.expanded_force import ExpandedForce
from cbsr_qa.domain.run.run import PhaseRecord, RunRecord
from cbsr_qa.stats.conformity import decide_error

#: Phases that press all over the sheet: presses repeated at one place do not represent it.
_ROLES: Final = (Role.GRID, Role.RANDOM)


@dataclass(frozen=True, slots=True)
class _Reading:
    phase: str
    press: ReferencePress
    indicated_N: float


def check_loads(
    record: RunRecord, recipe: Recipe, calibration: Calibration, settings: CertificateSettings | None
) -> tuple[tuple[CheckedLoad, ...], tuple[LeftOutLoad, ...]]:
    """Return the held-out loads: those within the stated range, judged by the laboratory's requirement, and the rest.

    A load lies within the range by its mean force over the steady frames, as the range was set; its error is that of
    the last of them. All of them count, whether or not the calibration agrees with them.

    Parameters
    ----------
    settings : requirement and decision rule; None: the loads are not judged.

    Raises
    ------
    CalibrationError
        If the uncertainty of an error cannot be evaluated, or the calibration tells no force of a load within its
        range.
    """
    readings: list[_Reading] = []
    left_out: list[LeftOutLoad] = []
    for phase in record.phases:
        if phase.role not in _ROLES or phase.name in recipe.calibrate_phases:
            continue
        for read in _read_loads(phase, record, recipe, calibration):
            if isinstance(read, LeftOutLoad):
                left_out.append(read)
            else:
                readings.append(read)
    errors = evaluate_errors(calibration.issued, [reading.press for reading in readings])
    judged = (_judge_load(reading, error, settings) for reading, error in zip(readings, errors, strict=True))
    return tuple(judged), tuple(left_out)


def _read_loads(
    phase: PhaseRecord, record: RunRecord, recipe: Recipe, calibration: Calibration
) -> Iterator[_Reading | LeftOutLoad]:
    """Yield each load as the load cell and the sensor read it, or why it is not checked."""
    for load in phase.loads:
        window = load_window(phase, load, recipe.analysis)
        last = window.steady.select(slice(len(window.steady) - 1, None))  # U is that of one frame
        samples, place_mm = phase.channel("force"), (load.load.x_mm, load.load.y_mm)
        reference_N, stderr_N = mean_force(samples, last, load)
        steady_N, _ = mean_force(samples, window.steady, load)
        if reference_N is None or stderr_N is None or steady_N is None:
            yield LeftOutLoad(phase.name, place_mm, "no force was recorded")
            continue
        if why := _find_obstacle(phase, load, record):
            yield LeftOutLoad(phase.name, place_mm, why)
            continue
        (indicated_N,) = calibration.force(last.voltages, place_mm=place_mm).force_N.tolist()
        if not _is_within(calibration.issued.validity, steady_N, place_mm):
            known_N = indicated_N if isfinite(indicated_N) else None
            yield LeftOutLoad(phase.name, place_mm, "", reference_N, known_N)
            continue
        if not isfinite(indicated_N):
            raise CalibrationError(
                f"the calibration tells no force of load {load.load.label} of phase {phase.name!r}, within its range"
            )
        settling_s = float(last.time_s[0]) - load.hold_start_s
        count = len(select_forces(samples, last, load))
        press = ReferencePress(place_mm, settling_s, reference_N, stderr_N, count, steady_N)
        yield _Reading(phase.name, press, indicated_N)


def _is_within(validity: Validity, force_N: float, place_mm: tuple[float, float]) -> bool:
    assert validity.force_N is not None
    lowest_N, highest_N = validity.force_N
    return lowest_N <= force_N <= highest_N and float(np.hypot(*place_mm)) <= validity.radius_mm


def _find_obstacle(phase: PhaseRecord, load: LoadRecord, record: RunRecord) -> str:
    """Say why the load cell did not tell the force of a load alone; empty if it did."""
    if list_neighbours(record.indenter, phase, load, load.release_start_s - 1e-6):
        return "it was pressed together with others"
    return describe_cell_limit(phase.channel("force"), load)


def _judge_load(reading: _Reading, error: ExpandedForce, settings: CertificateSettings | None) -> CheckedLoad:
    reference_N, indicated_N = reading.press.force_N, reading.indicated_N
    if settings is None or not settings.judges:
        return CheckedLoad(reading.phase, reference_N, indicated_N, error)
    maximum_N = settings.max_error_of(reference_N)
    decision = decide_error(
        indicated_N - reference_N,
        maximum_N,
        error.U_N if settings.decision == "guarded" else 0.0,
        error.standard_uncertainty_N,
        error.dof,
    )
    outcome, conformance = str(decision.outcome), decision.conformance
    return CheckedLoad(reading.phase, reference_N, indicated_N, error, maximum_N, outcome, conformance)
