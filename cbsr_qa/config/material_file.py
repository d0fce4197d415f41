"""Material files: every parameter with its source, or said to be chosen by us."""

from collections.abc import Iterator
from typing import Annotated

from pydantic import Field

from cbsr_qa.config.lines import KeyPath
from cbsr_qa.config.strip_tables import StripRelaxationTable
from cbsr_qa.config.tables import FileModel, Problem, Table
from cbsr_qa.domain.sensor import Material, Parameter, QuasiStatic, Relaxation

Name = Annotated[str, Field(min_length=1, max_length=64)]
Source = Annotated[str, Field(min_length=1, max_length=1000)]
Pair = Annotated[list[float], Field(min_length=2, max_length=2)]
#: Digits that are lost when standard errors and covariance are written by hand.
_ROUNDING = 1e-3


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
