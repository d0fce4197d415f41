"""Material files, read and written: every parameter with its source, or said to be chosen by us.

A material that was measured on a strip has ``[material.strip_relaxation]``: how the strip relaxed, with errors.
"""

import json
from collections.abc import Iterator, Sequence
from typing import Annotated

import numpy as np
from pydantic import Field

from cbsr_qa.config.tables import FileModel
from cbsr_qa.domain.sensor import Material, MeasuredKernel, Parameter, QuasiStatic, Relaxation, StripRelaxation
from cbsr_qa.plugin import KeyPath, Problem, Table

Positive = Annotated[float, Field(gt=0)]
Strain = Annotated[float, Field(gt=0, lt=1)]
#: Digits that are lost when a covariance is written by hand.
_ROUNDING = 1e-3
#: No characterisation tells more exponentials than this.
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
        """Yield what does not fit together within the table."""
        count = len(self.weights)
        if len(self.time_constants_s) != count:
            what = f"has {len(self.time_constants_s)} numbers, weights {count}; one for each"
            yield Problem((*where, "time_constants_s"), what)
        elif any(len(row) != 2 * count for row in self.covariance) or len(self.covariance) != 2 * count:
            what = f"must have {2 * count} rows of {2 * count} numbers: of weights, then of log time constants"
            yield Problem((*where, "covariance"), what)
        else:
            yield from self._no_covariance(where)
        if self.start_s >= self.window_s:
            what = f"is {self.start_s:g} s; must be below window_s, {self.window_s:g} s"
            yield Problem((*where, "start_s"), what)

    def _no_covariance(self, where: KeyPath) -> Iterator[Problem]:
        """Yield why these numbers are no covariance: some combination would have a negative variance."""
        given = np.array(self.covariance)
        diagonal = np.diag(given)
        scale = np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
        correlation = given / scale / scale[:, None]
        if not np.allclose(correlation, correlation.T, atol=_ROUNDING):
            yield Problem((*where, "covariance"), "must be symmetric")
        elif diagonal.min() < 0 or np.linalg.eigvalsh(correlation).min() < -_ROUNDING:
            yield Problem((*where, "covariance"), "is no covariance: a variance would be negative")

    def to_domain(self) -> MeasuredKernel:
        """Return the kernel."""
        return MeasuredKernel(
            tuple(self.weights),
            tuple(self.time_constants_s),
            tuple(tuple(row) for row in self.covariance),
            self.start_s,
            self.window_s,
        )


class StripRelaxationTable(Table):
    """What it was learned from, and a table for each direction that could be told."""

    cycles: Annotated[int, Field(gt=0)]
    least_strain: Strain
    largest_strain: Strain
    source: Annotated[str, Field(min_length=1, max_length=1000)]
    loading: MeasuredKernelTable | None = None
    unloading: MeasuredKernelTable | None = None

    def problems(self, where: KeyPath) -> Iterator[Problem]:
        """Yield what does not fit together within the table and those below it."""
        if self.least_strain > self.largest_strain:
            what = f"is {self.least_strain:g}, above largest_strain, {self.largest_strain:g}"
            yield Problem((*where, "least_strain"), what)
        for name, kernel in (("loading", self.loading), ("unloading", self.unloading)):
            if kernel is not None:
                yield from kernel.problems((*where, name))

    def to_domain(self) -> StripRelaxation:
        """Return the relaxation."""
        return StripRelaxation(
            None if self.loading is None else self.loading.to_domain(),
            None if self.unloading is None else self.unloading.to_domain(),
            self.cycles,
            self.least_strain,
            self.largest_strain,
            self.source,
        )


Name = Annotated[str, Field(min_length=1, max_length=64)]
Source = Annotated[str, Field(min_length=1, max_length=1000)]
Pair = Annotated[list[float], Field(min_length=2, max_length=2)]
#: Digits that are lost when standard errors and covariance are written by hand.


class ParameterTable(Table):
    """A parameter of either sign with its standard error, where one is stated, and its source."""

    value: float
    stderr: Annotated[float, Field(ge=0)] | None = None
    source: Source

    def to_domain(self) -> Parameter:
        """Return the parameter."""
        return Parameter(self.value, self.stderr, self.source)


class PositiveParameterTable(ParameterTable):
    """A parameter that cannot be zero or negative."""

    value: Annotated[float, Field(gt=0)]


class StressTable(Table):
    """``[against_stress]``: Δρ/ρ₀ = slope · stress + intercept (paper Eq 1)."""

    slope_per_kPa: ParameterTable
    intercept: ParameterTable
    covariance: float | None = None

    def to_domain(self) -> QuasiStatic:
        """Return the line."""
        return QuasiStatic(self.slope_per_kPa.to_domain(), self.intercept.to_domain(), self.covariance)


class StrainTable(Table):
    """``[against_strain]``: Δρ/ρ₀ = slope · strain + intercept (paper Eq 2), strain as a fraction."""

    slope: ParameterTable
    intercept: ParameterTable
    covariance: float | None = None

    def to_domain(self) -> QuasiStatic:
        """Return the line."""
        return QuasiStatic(self.slope.to_domain(), self.intercept.to_domain(), self.covariance)


def _covariance_problems(line: StressTable | StrainTable, where: KeyPath) -> Iterator[Problem]:
    """Yield why slope and intercept cannot have the covariance that is stated: a variance would be negative."""
    if line.covariance is None:
        return
    fit = line.to_domain()
    if fit.slope.stderr is None or fit.intercept.stderr is None:
        what = "is stated without the standard errors of slope and intercept; state both or leave it out"
        yield Problem((*where, "covariance"), what)
        return
    most = fit.slope.stderr * fit.intercept.stderr
    if abs(line.covariance) > most * (1 + _ROUNDING):
        what = f"is {line.covariance:g}; the product of the standard errors, {most:g}, is its largest size"
        yield Problem((*where, "covariance"), what)


class RelaxationTable(Table):
    """A relaxation of a unit step: weights relative to its steady change, and two rising time constants."""

    weights: Pair
    time_constants_s: Annotated[list[Annotated[float, Field(gt=0)]], Field(min_length=2, max_length=2)]
    source: Source

    def problems(self, where: KeyPath) -> Iterator[Problem]:
        """Yield what does not fit together within the table."""
        first, second = self.time_constants_s
        if first >= second:
            what = f"is [{first:g}, {second:g}]; the first must be below the second"
            yield Problem((*where, "time_constants_s"), what)

    def to_domain(self) -> Relaxation:
        """Return the relaxation."""
        return Relaxation(
            weights=(self.weights[0], self.weights[1]),
            time_constants_s=(self.time_constants_s[0], self.time_constants_s[1]),
            source=self.source,
        )


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

    def to_domain(self) -> Material:
        """Return the material."""
        return Material(
            name=self.name,
            interelectrode_resistance_ohm=self.interelectrode_resistance_ohm.to_domain(),
            modulus_kPa=self.modulus_kPa.to_domain(),
            against_stress=self.against_stress.to_domain(),
            against_strain=self.against_strain.to_domain(),
            stress_relaxation=self.stress_relaxation.to_domain(),
            loading_relaxation=self.loading_relaxation.to_domain(),
            unloading_relaxation=self.unloading_relaxation.to_domain(),
            relative_noise=self.relative_noise.to_domain(),
            strip_relaxation=None if self.strip_relaxation is None else self.strip_relaxation.to_domain(),
        )


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
        """Return the material."""
        return self.material.to_domain()


def material_text(material: Material, comments: Sequence[str] = ()) -> str:
    """Write a material as TOML.

    Parameters
    ----------
    comments : lines before everything else.

    Returns
    -------
    The file's content; numbers come back as they were.
    """
    return "\n".join([*(f"# {line}".rstrip() for line in comments), *_lines(material)]) + "\n"


def _lines(material: Material) -> Iterator[str]:
    yield from ("", "[material]", f"name = {_text(material.name)}")
    yield from _parameter("interelectrode_resistance_ohm", material.interelectrode_resistance_ohm)
    yield from _parameter("modulus_kPa", material.modulus_kPa)
    yield from _parameter("relative_noise", material.relative_noise)
    yield from _quasi_static("against_stress", "slope_per_kPa", material.against_stress)
    yield from _quasi_static("against_strain", "slope", material.against_strain)
    yield from _relaxation("stress_relaxation", material.stress_relaxation)
    yield from _relaxation("loading_relaxation", material.loading_relaxation)
    yield from _relaxation("unloading_relaxation", material.unloading_relaxation)
    if material.strip_relaxation is not None:
        yield from _strip(material.strip_relaxation)


def _parameter(name: str, parameter: Parameter) -> Iterator[str]:
    yield from ("", f"[material.{name}]", f"value = {_number(parameter.value)}")
    if parameter.stderr is not None:
        yield f"stderr = {_number(parameter.stderr)}"
    yield f"source = {_text(parameter.source)}"


def _quasi_static(name: str, slope: str, line: QuasiStatic) -> Iterator[str]:
    if line.covariance is not None:
        yield from ("", f"[material.{name}]", f"covariance = {_number(line.covariance)}")
    yield from _parameter(f"{name}.{slope}", line.slope)
    yield from _parameter(f"{name}.intercept", line.intercept)


def _relaxation(name: str, kernel: Relaxation) -> Iterator[str]:
    yield from ("", f"[material.{name}]")
    yield f"weights = {_numbers(kernel.weights)}"
    yield f"time_constants_s = {_numbers(kernel.time_constants_s)}"
    yield f"source = {_text(kernel.source)}"


def _strip(strip: StripRelaxation) -> Iterator[str]:
    yield from ("", "[material.strip_relaxation]", f"cycles = {strip.cycles}")
    yield f"least_strain = {_number(strip.least_strain)}"
    yield f"largest_strain = {_number(strip.largest_strain)}"
    yield f"source = {_text(strip.source)}"
    for name, kernel in (("loading", strip.loading), ("unloading", strip.unloading)):
        if kernel is not None:
            yield from _measured(f"strip_relaxation.{name}", kernel)


def _measured(name: str, kernel: MeasuredKernel) -> Iterator[str]:
    yield from ("", f"[material.{name}]", f"weights = {_numbers(kernel.weights)}")
    yield f"time_constants_s = {_numbers(kernel.time_constants_s)}"
    yield f"covariance = [{', '.join(_numbers(row) for row in kernel.covariance)}]"
    yield f"start_s = {_number(kernel.start_s)}"
    yield f"window_s = {_number(kernel.window_s)}"


def _numbers(values: Sequence[float]) -> str:
    return f"[{', '.join(map(_number, values))}]"


def _number(value: float) -> str:
    return repr(float(value))


def _text(value: str) -> str:
    """Quote text: TOML's basic strings are JSON's, but for DEL."""
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007F")
