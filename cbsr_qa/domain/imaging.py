"""Images: one value per mesh element, and the regions found in them.

Problem that a reconstruction is given, and result of a linear one.
"""

from dataclasses import dataclass, field
from functools import cached_property
from typing import Annotated, Final, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain.errors import NumericsError, RefusedError
from cbsr_qa.domain.kept import FROM_ABOVE, NOT_KEPT, Kept
from cbsr_qa.domain.numbers import Array, real_numbers
from cbsr_qa.domain.sensor.mesh import Mesh
from cbsr_qa.domain.sensor.sensor_type import SensorType

#: Steps of matrix and Jacobian in a file: an image changes by up to 1.2e-3 of its noise (docs/decisions/0047).
_STEPS: Final = 2**13


@dataclass(frozen=True, slots=True, eq=False)
class Image:
    """Relative conductance change Δγ/γ₀ per element, positive where the material conducts more.

    Parameters
    ----------
    mesh : mesh of e elements.
    values : (e,) float64, relative.
    """

    mesh: Mesh
    values: Array

    def __post_init__(self) -> None:
        if self.values.shape != (len(self.mesh.elements),):
            raise RefusedError(f"an image of {self.values.shape} does not fit {len(self.mesh.elements)} elements")
        if not np.isfinite(self.values).all():
            raise RefusedError("an image holds values that are not finite numbers")


class Region(Protocol):
    """A sensed region, of whole elements or bounded by a contour: the input of spatial metrics."""

    @property
    def area_mm2(self) -> float:
        """Area A_b [mm²]."""
        ...

    @property
    def weight(self) -> float:
        """Integral of the image over the region [mm²]."""
        ...

    def centre_mm(self) -> Array:
        """Centre of mass M of the image over the region: (2,) [mm]."""
        ...

    def rim_mm(self) -> tuple[Array, Array]:
        """Starts and ends (k, 2) [mm] of the straight pieces of the perimeter, the region to their left."""
        ...


@dataclass(frozen=True, eq=False)
class Blob:
    """Connected elements above the mask's threshold.

    Parameters
    ----------
    image : the response-signed image, noise floor subtracted, that was masked.
    elements : (k,) int64 indices into its mesh, rising, at least one.
    """

    image: Image
    elements: NDArray[np.int64]

    @cached_property
    def area_mm2(self) -> float:
        """Area A_b [mm²]."""
        return float(self.image.mesh.areas_mm2[self.elements].sum())

    @cached_property
    def weight(self) -> float:
        """Integral of the values over the blob [mm²]."""
        return float(self._weights.sum())

    def centre_mm(self) -> Array:
        """Centre of mass M, area- and value-weighted: (2,) [mm]."""
        return self._weights @ self.image.mesh.centroids_mm[self.elements] / self.weight

    @cached_property
    def rim(self) -> NDArray[np.int64]:
        """Edges of exactly one element of the blob, holes' rims included: (k, 2) nodes, the blob to their left."""
        mesh = self.image.mesh
        edges = mesh.element_edges[self.elements]
        single_mask = np.bincount(edges.ravel())[edges] == 1
        corners = mesh.elements[self.elements]
        return np.column_stack([corners[single_mask], corners[:, [1, 2, 0]][single_mask]])

    def rim_mm(self) -> tuple[Array, Array]:
        """Starts and ends (k, 2) [mm] of the rim's edges."""
        nodes_mm = self.image.mesh.nodes_mm
        return nodes_mm[self.rim[:, 0]], nodes_mm[self.rim[:, 1]]

    @cached_property
    def _weights(self) -> Array:
        return self.image.values[self.elements] * self.image.mesh.areas_mm2[self.elements]


@dataclass(frozen=True, slots=True, eq=False)
class ImagingProblem:
    """The linearised forward model around the unloaded homogeneous sheet.

    Parameters
    ----------
    mesh : mesh of the image, e elements (coarser than the forward model's; no electrodes needed).
    jacobian : (m, e) float64, change of the m used readings per *relative* change of an element's conductance,
        at unit current and unit sheet conductance [V/(A·Ω)].
    reference : (m,) float64, the used readings of the unloaded sheet, same scaling.
    used : (drives, measures) bool with m True entries; readings are taken in C order.
    noise_variance : (m,) float64 variances of the used readings relative to their harmonic mean, or None for equal
        noise on all.
    nominal : the sensor type's problem with every reading its pattern images and equal noise: what belongs to the
        type, such as λ, is chosen on it. None where this is it.
    sample : (k, m) float64 measured changes, scaled as ``reference``, for a choice of λ that looks at data
        (generalised cross-validation, L-curve, discrepancy). None if there are none: it then simulates its own.
    measured : (m,) float64, the used readings of this sensor's own reference frame, scaled as ``reference``, for
        absolute images. None where only differences are known.
    """

    sensor_type: Annotated[SensorType, FROM_ABOVE]
    mesh: Annotated[Mesh, Kept("/mesh/", prepared=True)]
    jacobian: Annotated[Array, Kept(units="V/(A.Ohm)", prepared=True, shortest=True, steps=_STEPS)]
    reference: Annotated[Array, Kept(units="V/(A.Ohm)", prepared=True)]
    used: NDArray[np.bool_]
    noise_variance: Annotated[Array | None, Kept(prepared=True)] = None
    nominal: Annotated[Self | None, NOT_KEPT] = None
    sample: Annotated[Array | None, NOT_KEPT] = None
    measured: Annotated[Array | None, NOT_KEPT] = None

    def __post_init__(self) -> None:
        count = int(self.used.sum())
        if self.jacobian.shape != (count, len(self.mesh.elements)) or self.reference.shape != (count,):
            raise RefusedError(
                f"Jacobian {self.jacobian.shape} and reference {self.reference.shape} do not match"
                f" {count} used readings on {len(self.mesh.elements)} elements"
            )


@dataclass(frozen=True, slots=True)
class ParameterAnswer:
    """Choice of one criterion for the regularisation parameter.

    Parameters
    ----------
    criterion : its name, e.g. ``"gcv"``.
    value : value that the criterion would choose; None where it has no answer.
    words : reason for the value, or for having none.
    """

    criterion: str
    value: float | None
    words: str


@dataclass(frozen=True, slots=True, eq=False)
class ParameterCurve:
    """The candidates for the regularisation parameter, and their criteria.

    Parameters
    ----------
    values : (k,) float64 of the parameter, rising.
    noise_figures : (k,) float64, Adler et al. 2009 form, on the model the choice was made on.
    answers : answers of every criterion, the one that decided among them; their values are among ``values``.
    target : noise figure that the criterion of that name asks for; None if not stated.
    discrete : whether the parameter is a count, and ``values`` are all there are.
    """

    values: Array
    noise_figures: Array
    answers: tuple[ParameterAnswer, ...]
    target: float | None = None
    discrete: bool = False

    def noise_figure_at(self, value: float) -> float | None:
        """Noise figure of a candidate value; None of others."""
        where = np.flatnonzero(self.values == value)
        return float(self.noise_figures[where[0]]) if where.size else None


@dataclass(frozen=True, slots=True)
class ParameterChoice:
    """A regularisation parameter and the reason for its value.

    Parameters
    ----------
    value : λ, or what the method has in its place.
    how : the criterion and its result in words, e.g. ``"noise figure 1.00 on the nominal model"``.
    noise_figure : noise figure of the resulting matrix in the form of Adler et al. 2009, on the nominal model.
    name : name of the parameter that ``value`` is.
    curve : choices and their figures; None where the value was given, or is read from a file.
    criterion : name of the criterion in one word (``"noise-figure"``, ``"gcv"``, ``"l-curve"``, ``"discrepancy"``,
        ``"given"``, ``"none"`` where there is nothing to choose); empty if not stated.
    """

    value: Annotated[float, Kept("regularisation")]
    how: Annotated[str, Kept("regularisation_how")]
    noise_figure: float
    name: Annotated[str, Kept("regularisation_name")] = "λ"
    curve: Annotated[ParameterCurve | None, NOT_KEPT] = field(default=None, compare=False)
    criterion: Annotated[str, Kept("regularisation_criterion")] = ""


class PreparedReconstruction(Protocol):
    """Interface of every prepared method; single-matrix methods are a :class:`LinearReconstruction`.

    Runs, whose calibration holds the matrix, take linear methods only; ``analyse`` takes all.
    """

    @property
    def method(self) -> str:
        """Name of the plugin."""
        ...

    @property
    def problem(self) -> ImagingProblem: ...

    @property
    def choice(self) -> ParameterChoice:
        """The regularisation parameter and the reason for its value."""
        ...

    def images(self, changes: Array) -> Array:
        """Relative conductance changes (n, e) of scaled changes (n, m): consecutive frames of one recording."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class LinearReconstruction:
    """One matrix per sensor type, x = R·y, applied to whole runs as a matrix product.

    ``y`` are the used readings' changes (V − V_ref)/s, where s is the scale of the sensor against the unit model,
    s = ⟨V_ref, reference⟩ / ⟨reference, reference⟩ (a least-squares fit of sheet resistance times current).

    Parameters
    ----------
    matrix : (e, m) float64.
    """

    method: str
    problem: Annotated[ImagingProblem, Kept("")]
    matrix: Annotated[Array, Kept(units="A.Ohm/V", prepared=True, shortest=True, steps=_STEPS, columns=True)]
    choice: Annotated[ParameterChoice, Kept("")]

    def images(self, changes: Array) -> Array:
        """Reconstruct relative conductance changes.

        Parameters
        ----------
        changes : (n, m) float64, scaled changes of the used readings.

        Returns
        -------
        (n, e) float64.

        Raises
        ------
        RefusedError
            For the reasons of :func:`check_readings`.
        """
        return check_readings(changes, self.problem) @ self.matrix.T


def check_readings(changes: Array, problem: ImagingProblem) -> Array:
    """Changes of the used readings, (n, m), as float64.

    Raises
    ------
    RefusedError
        If the number of readings is not the prepared one, or one is not a finite real number; names the first.
    """
    changes, count = real_numbers(changes, "readings"), len(problem.reference)
    if changes.ndim != 2 or changes.shape[1] != count:
        raise RefusedError(f"readings of shape {changes.shape} do not fit {count} used channels")
    not_finite = np.argwhere(~np.isfinite(changes))
    if not_finite.size:
        frame, reading = not_finite[0]
        drive, measure = np.argwhere(problem.used)[reading]
        raise RefusedError(
            f"the reading of drive pair {drive} and measure pair {measure} in frame {frame} is"
            f" {changes[frame, reading]}, not a finite number (one of {len(not_finite)} such)",
            remedy="mask its channel instead of imaging it",
        )
    return changes


def linear(prepared: PreparedReconstruction) -> LinearReconstruction:
    """Narrow to a single-matrix method.

    Raises
    ------
    NumericsError
        If the method is not: a run's calibration holds its matrix.
    """
    if not isinstance(prepared, LinearReconstruction):
        raise NumericsError(
            f"reconstruction {prepared.method!r} is not a single matrix, which a run's calibration needs",
            remedy="use a linear method in a recipe; `cbsr-qa analyse` can use this one",
        )
    return prepared


@dataclass(frozen=True, slots=True)
class OverlapBand:
    """One band of the area-overlap scale, [lower, upper) percent."""

    name: Annotated[str, Kept("band")]
    lower: Annotated[float, Kept(units="%")]
    upper: Annotated[float, Kept(units="%")]
