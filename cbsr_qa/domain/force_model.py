"""What turns a sensor's readings into newtons: fields of its head by place, and how strongly each place answers."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain.relaxation import RelaxationKernel

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

#: Plain numbers of a force model, by the names of its fields.
NUMBERS: Final = (
    "scatter",
    "threshold",
    "misfit",
    "residue_share",
    "residue_stderr",
    "residue_strength",
    "steady_s",
    "place_scatter_mm",
)


@dataclass(frozen=True, slots=True)
class Lattice:
    """Places on a square lattice, x = x₀ + i h and y = y₀ + j h.

    Parameters
    ----------
    x_mm, y_mm : x₀ and y₀, from the sheet's centre.
    spacing_mm : h.
    columns, rows : how many along x and y.
    """

    x_mm: float
    y_mm: float
    spacing_mm: float
    columns: int
    rows: int

    def places_mm(self) -> Array:
        """All places, (rows · columns, 2), a row after the other [mm]."""
        x = self.x_mm + self.spacing_mm * np.arange(self.columns)
        y = self.y_mm + self.spacing_mm * np.arange(self.rows)
        return np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)


@dataclass(frozen=True, slots=True, eq=False)
class ForceModel:
    """How readings become the contrast under a head, and contrast becomes stress.

    A head that changes the conductance under it by κ = Δγ/γ changes the readings in proportion to its *strength*
    a = 2κ/(2 + κ), but for some 0.2 %. At node k of the lattice the readings' change per strength, in standard
    errors of one frame, is row k of ``templates``. Relative response: κ = S (α_σ σ + β_σ) with S = ρ̄₀ over its
    nominal value, 1 for a sheet that answers as its material (paper Eqs 1 and 7).

    Parameters
    ----------
    lattice : of the places.
    node : (rows, columns) int64 index of each place into the arrays below; −1 where no head can be.
    merging : (r, m) [1/V] turns changes of the m used readings into r rows of unit noise.
    templates : (n, r) rows of unit length: the readings' change under the calibrated head is strength × e^log_size ×
        template.
    log_size : (n,) logarithm of a change per strength, in standard errors of one frame.
    size_slope : (n, r) by which a template grows with q − 1, q the head's squared radius over that of the calibrated
        one, at the same strength × area.
    slopes : (n, 5) of ``log_size`` along x and y [1/mm], and products xx, xy, yy of the slopes of a template of unit
        length, how fast it turns with place [1/mm²].
    fits : (n,) whether the head is clear of edge and electrodes there; other nodes are there to interpolate from.
    log_response : (n,) ln S, the map.
    log_response_stderr : (n,) its standard error, without ``scatter``.
    scatter : relative deviation of single loads about the map that noise does not explain.
    stress_kPa : (lowest, highest) of the loads the map was learned from.
    threshold : least detectability d′ (signal over noise of the readings) that counts as a load.
    misfit : largest share of a load's signal, as energy, that the template of a second head may explain before the
        frame counts as one of several. In files of before it was that of all that a template leaves, 0.04 at least.
    residue_share, residue_stderr : share of what earlier loads left just before a press that is still there at its
        steady frames, as the calibration took it.
    residue_strength : root mean square of the strength that earlier loads had left where a load was then pressed.
    steady_s : how long after the ramp's end the map's loads were looked at; forces are of loads held so long [s].
    place_scatter_mm : standard deviation of a found place about the true one, along an axis, beyond noise.
    loading, unloading : how loads get there, and how they fade; None where it was not learned.
    """

    lattice: Lattice
    node: Indices
    merging: Array
    templates: Array
    log_size: Array
    size_slope: Array
    slopes: Array
    fits: NDArray[np.bool_]
    log_response: Array
    log_response_stderr: Array
    scatter: float
    stress_kPa: tuple[float, float]
    threshold: float
    misfit: float
    residue_share: float
    residue_stderr: float
    residue_strength: float = 0.0
    steady_s: float = 0.0
    place_scatter_mm: float = 0.0
    loading: RelaxationKernel | None = None
    unloading: RelaxationKernel | None = None
