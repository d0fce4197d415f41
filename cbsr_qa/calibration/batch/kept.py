"""What is kept of a batch's model, as the prior and the kernels that a further sensor is calibrated with."""

from collections.abc import Sequence
from dataclasses import asdict
from typing import Final

import numpy as np

from cbsr_qa.calibration.batch.likelihood import BatchLikelihood, Hyperparameters
from cbsr_qa.calibration.batch.loads import BatchLoads, SensorLoads
from cbsr_qa.calibration.batch.prior import BatchPrior
from cbsr_qa.domain.errors import CalibrationError
from cbsr_qa.domain.plan.batch_model import KeptBatch, KeptKernel, KeptMember, KeptSensor
from cbsr_qa.domain.results.relaxation import RelaxationKernel

#: Bounds of hyperparameters: logarithms of a response and lengths in mm are far within them.
_LARGEST: Final = 1000.0
_SHORTEST_MM: Final = 0.1
#: What weights that were rounded to text may sum to beside 1.
_ROUNDING: Final = 1e-6


def check_kept(kept: KeptBatch) -> None:
    """Raise CalibrationError, naming the key, if a number of a model is impossible."""
    for number, sensor in enumerate(kept.sensors):
        loads, columns = len(sensor.places_mm), [sensor.log_response, sensor.variance]
        columns += [] if sensor.bend is None else [sensor.bend]
        if {len(column) for column in columns} != {loads}:
            raise _make_error(f"sensors[{number}]", f"of {loads} places", "of as many responses and variances")
    _check_members(kept)
    relaxation = kept.relaxation
    if relaxation is None:
        return
    if not 0 < relaxation.steady_s <= relaxation.hold_s:
        raise _make_error("relaxation.steady_s", relaxation.steady_s, f"above 0 and at most {relaxation.hold_s:g}")
    for name in ("strength", "stress", "unloading"):
        if (kernel := getattr(relaxation, name)) is not None:
            _check_kernel(kernel, f"relaxation.{name}")


def _check_members(kept: KeptBatch) -> None:
    for number, member in enumerate(kept.members):
        for name in ("scatter", "own", "common", "level", "weight", "length_mm"):
            value, least = getattr(member, name), _SHORTEST_MM if name == "length_mm" else 0.0
            if not least <= value <= _LARGEST:
                raise _make_error(f"members[{number}].{name}", value, f"from {least:g} to {_LARGEST:g}")
    total = sum(member.weight for member in kept.members)
    if not kept.sensors or abs(total - 1) > _ROUNDING:
        raise _make_error("members", f"of weights with sum {total:.6g}", "of sensors, with sum 1")


def _check_kernel(kernel: KeptKernel, key: str) -> None:
    terms = len(kernel.weights)
    square = [len(row) for row in kernel.covariance] == [2 * terms] * (2 * terms)
    if not terms or not square or {len(kernel.time_constants_s), len(kernel.scatter)} != {terms}:
        raise _make_error(key, f"of {terms} weights", "of as many time constants and scatters, and their covariance")
    bounds = (
        ("time_constants_s", min(kernel.time_constants_s) > 0, "above 0"),
        ("scatter", min(kernel.scatter) >= 0, "0 or more"),
        ("scatter_freedom", kernel.scatter_freedom > 0, "above 0"),
        ("loads", kernel.loads >= 1, "1 or more"),
        ("start_s", kernel.start_s >= 0, "0 or more"),
    )
    for name, possible, allowed in bounds:
        if not possible:
            raise _make_error(f"{key}.{name}", getattr(kernel, name), allowed)


def _make_error(key: str, value: object, allowed: str) -> CalibrationError:
    return CalibrationError(f"{key} is {value}; it must be {allowed}", remedy="learn it again")


def make_prior(kept: KeptBatch) -> BatchPrior:
    """Return the prior of a further sensor. CalibrationError if a number of it is impossible."""
    check_kept(kept)
    sensors = [make_loads(sensor) for sensor in kept.sensors]
    choices = [
        Hyperparameters(one.smooth, one.length_mm, one.scatter, one.own, one.common, one.level)
        for one in kept.members
    ]
    return BatchPrior(BatchLikelihood(BatchLoads(sensors)), choices, [member.weight for member in kept.members])


def keep_members(choices: Sequence[Hyperparameters], weights: Sequence[float]) -> tuple[KeptMember, ...]:
    """Return what is kept of the members of a prior."""
    return tuple(KeptMember(**asdict(choice), weight=weight) for choice, weight in zip(choices, weights, strict=True))


def keep_loads(serial: str, run: str, chain_head: str, loads: SensorLoads) -> KeptSensor:
    """Return what is kept of a sensor's loads."""
    return KeptSensor(
        serial=serial,
        run=run,
        chain_head=chain_head,
        places_mm=tuple((x, y) for x, y in loads.places_mm.tolist()),
        log_response=tuple(loads.log_response.tolist()),
        variance=tuple(loads.variance.tolist()),
        bend=None if loads.bend is None else tuple(loads.bend.tolist()),
        bend_stderr=loads.bend_stderr,
    )


def make_loads(kept: KeptSensor) -> SensorLoads:
    """Return the loads that were kept of a sensor."""
    return SensorLoads(
        np.array(kept.places_mm, dtype=np.float64).reshape(-1, 2),
        np.array(kept.log_response),
        np.array(kept.variance),
        None if kept.bend is None else np.array(kept.bend),
        kept.bend_stderr,
    )


def keep_kernel(kernel: RelaxationKernel) -> KeptKernel:
    """Return what is kept of a kernel that was learned."""
    return KeptKernel(
        loading=kernel.loading,
        weights=tuple(kernel.weights.tolist()),
        time_constants_s=tuple(kernel.time_constants_s.tolist()),
        covariance=tuple(map(tuple, kernel.covariance.tolist())),
        scatter=tuple(kernel.scatter.tolist()),
        scatter_freedom=float(kernel.scatter_freedom),
        loads=kernel.loads,
        start_s=float(kernel.start_s),
    )


def make_kernel(kept: KeptKernel) -> RelaxationKernel:
    """Return the kernel that was kept."""
    return RelaxationKernel(
        kept.loading,
        np.array(kept.weights),
        np.array(kept.time_constants_s),
        np.array(kept.covariance),
        np.array(kept.scatter),
        kept.scatter_freedom,
        kept.loads,
        kept.start_s,
    )
