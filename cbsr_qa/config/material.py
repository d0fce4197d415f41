"""Material files, read and written: every parameter has a source, or is marked as chosen by us.

A material measured on a strip has ``[material.strip_relaxation]``: how the strip relaxed, with errors.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from cbsr_qa.config.tables import FileModel
from cbsr_qa.config.text import toml_document
from cbsr_qa.domain.filling import fill_from_mapping
from cbsr_qa.domain.sensor.sensor_type import Material
from cbsr_qa.plugin.problems import Problem, Table
from cbsr_qa.system.words import KeyPath

Positive = Annotated[float, Field(gt=0)]
Strain = Annotated[float, Field(gt=0, lt=1)]
#: Tolerance for the digits that are lost when a covariance is written by hand.
_ROUNDING = 1e-3
#: Most exponentials of a kernel; no characterisation resolves more.
_MOST = 4


class MeasuredKernelTable(Table):
    """Weights and time constants, with the covariance of (weights, logarithms of the time constants)."""

    weights: Annotated[list[float], Field(min_length=1, max_length=_MOST)]
    time_constants_s: Annotated[list[Positive], Field(min_length=1, max_length=_MOST)]
    covariance: Annotated[
        list[Annotated[list[float], Field(max_length=2 * _MOST)]], Field(min_length=2, max_length=2 * _MOST)
    ]
    start_s: Annotated[float, Field(ge=0)]
    window_s: Positive

    def problems(self, where: KeyPath) -> Iterator[Problem]:
        count = len(self.weights)
        if len(self.time_constants_s) != count:
            finding = f"has {len(self.time_constants_s)} numbers, weights {count}; one for each"
            yield Problem((*where, "time_constants_s"), finding)
        elif any(len(row) != 2 * count for row in self.covariance) or len(self.covariance) != 2 * count:
            finding = f"must have {2 * count} rows of {2 * count} numbers: of weights, then of log time constants"
            yield Problem((*where, "covariance"), finding)
        else:
            yield from self._covariance_problems(where)
        if self.start_s >= self.window_s:
            finding = f"is {self.start_s:g} s; must be below window_s, {self.window_s:g} s"
            yield Problem((*where, "start_s"), finding)

    def _covariance_problems(self, where: KeyPath) -> Iterator[Problem]:
        """Yield a problem if these numbers are no covariance: some combination would have a negative variance."""
        covariance = np.array(self.covariance)
        diagonal = np.diag(covariance)
        scale = np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
        correlation = covariance / scale / scale[:, None]
        if not np.allclose(correlation, correlation.T, atol=_ROUNDING):
            yield Problem((*where, "covariance"), "must be symmetric")
        elif diagonal.min() < 0 or np.linalg.eigvalsh(correlation).min() < -_ROUNDING:
            yield Problem((*where, "covariance"), "is no covariance: a variance would be negative")


class StripRelaxationTable(Table):
    """Its origin, and a table for each direction that could be determined."""

    cycles: Annotated[int, Field(gt=0)]
    least_strain: Strain
    largest_strain: Strain
    source: Annotated[str, Field(min_length=1, max_length=1000)]
    loading: MeasuredKernelTable | None = None
    unloading: MeasuredKernelTable | None = None

    def problems(self, where: KeyPath) -> Iterator[Problem]:
        if self.least_strain > self.largest_strain:
            finding = f"is {self.least_strain:g}, above largest_strain, {self.largest_strain:g}"
            yield Problem((*where, "least_strain"), finding)
        for name, kernel in (("loading", self.loading), ("unloading", self.unloading)):
            if kernel is not None:
                yield from kernel.problems((*where, name))


Name = Annotated[str, Field(min_length=1, max_length=64)]
Source = Annotated[str, Field(min_length=1, max_length=1000)]
Pair = Annotated[list[float], Field(min_length=2, max_length=2)]
#: Digits that are lost when standard errors and covariance are written by hand.


class ParameterTable(Table):
    """A parameter of either sign with its standard error, if stated, and its source."""

    value: float
    stderr: Annotated[float, Field(ge=0)] | None = None
    source: Source


class PositiveParameterTable(ParameterTable):
    """A parameter that cannot be zero or negative."""

    value: Annotated[float, Field(gt=0)]


class StressTable(Table):
    """``[against_stress]``: Δρ/ρ₀ = slope · stress + intercept (paper Eq 1)."""

    slope_per_kPa: ParameterTable
    intercept: ParameterTable
    covariance: float | None = None


class StrainTable(Table):
    """``[against_strain]``: Δρ/ρ₀ = slope · strain + intercept (paper Eq 2), strain as a fraction."""

    slope: ParameterTable
    intercept: ParameterTable
    covariance: float | None = None


def _covariance_problems(line: StressTable | StrainTable, where: KeyPath) -> Iterator[Problem]:
    """Yield a problem if slope and intercept cannot have the stated covariance: a variance would be negative."""
    if line.covariance is None:
        return
    slope = line.slope_per_kPa if isinstance(line, StressTable) else line.slope
    if slope.stderr is None or line.intercept.stderr is None:
        finding = "is stated without the standard errors of slope and intercept; state both or leave it out"
        yield Problem((*where, "covariance"), finding)
        return
    largest = slope.stderr * line.intercept.stderr
    if abs(line.covariance) > largest * (1 + _ROUNDING):
        finding = f"is {line.covariance:g}; the product of the standard errors, {largest:g}, is its largest size"
        yield Problem((*where, "covariance"), finding)


class RelaxationTable(Table):
    """A relaxation of a unit step: weights relative to its steady change, and two rising time constants."""

    weights: Pair
    time_constants_s: Annotated[list[Annotated[float, Field(gt=0)]], Field(min_length=2, max_length=2)]
    source: Source

    def problems(self, where: KeyPath) -> Iterator[Problem]:
        first_s, second_s = self.time_constants_s
        if first_s >= second_s:
            finding = f"is [{first_s:g}, {second_s:g}]; the first must be below the second"
            yield Problem((*where, "time_constants_s"), finding)


class MaterialTable(Table):
    """``[material]``: the name, and below it one table per parameter or relaxation."""

    name: Name
    interelectrode_resistance_ohm: PositiveParameterTable
    modulus_kPa: PositiveParameterTable
    relative_noise: PositiveParameterTable
    against_stress: StressTable
    against_strain: StrainTable
    stress_relaxation: RelaxationTable
    loading_relaxation: RelaxationTable
    unloading_relaxation: RelaxationTable
    strip_relaxation: StripRelaxationTable | None = None
    response_per_C: ParameterTable | None = None

    def to_domain(self) -> Material:
        data = self.model_dump()
        data["against_stress"]["slope"] = data["against_stress"].pop("slope_per_kPa")
        return fill_from_mapping(Material, data)


class MaterialFile(FileModel[Material]):
    """A material file."""

    material: MaterialTable

    def problems(self) -> Iterator[Problem]:
        """Time constants rise, and covariances fit their standard errors."""
        yield from _covariance_problems(self.material.against_stress, ("material", "against_stress"))
        yield from _covariance_problems(self.material.against_strain, ("material", "against_strain"))
        for name in ("stress_relaxation", "loading_relaxation", "unloading_relaxation"):
            yield from getattr(self.material, name).problems(("material", name))
        if self.material.strip_relaxation is not None:
            yield from self.material.strip_relaxation.problems(("material", "strip_relaxation"))

    def to_domain(self) -> Material:
        return self.material.to_domain()


def material_text(material: Material, comments: Sequence[str] = ()) -> str:
    """Write a material as TOML.

    Parameters
    ----------
    comments : comment lines before everything else.

    Returns
    -------
    The file's content; numbers come back as they were.
    """
    data = _drop_unstated(asdict(material))
    stress = data["against_stress"]
    data["against_stress"] = {"slope_per_kPa": stress.pop("slope"), **stress}
    ordered_tables = {key: data[key] for key in MaterialTable.model_fields if key in data}
    return toml_document({"material": ordered_tables}, comments)


def _drop_unstated(table: Mapping[str, Any]) -> dict[str, Any]:
    """Leave out unstated values, also in nested tables."""
    stated_values = {key: value for key, value in table.items() if value is not None}
    return {
        key: _drop_unstated(value) if isinstance(value, Mapping) else value for key, value in stated_values.items()
    }
