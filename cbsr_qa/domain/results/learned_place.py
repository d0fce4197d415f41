"""Model of the place of a press, learned from presses at known places, as kept in a calibration file.

Two estimates are mixed: a Gaussian process on readings (:class:`PlaceProcess`), and what readings are expected to be
over the sheet (:class:`PlaceTemplates`). Both are about the sheet's centre, in the axes of its electrodes.
"""

from dataclasses import dataclass
from typing import Annotated, Final

import numpy as np

from cbsr_qa.domain.kept import Kept
from cbsr_qa.domain.numbers import Array, Indices

#: Largest number of presses to learn from: the time to open a calibration grows with its cube, to 6 s at this number.
MOST_PRESSES: Final = 4000
_LARGEST = 1e12
#: Largest number of a node, counted from the centre: far more than any sheet has.
_LARGEST_NODE = 1000

_Positive = Annotated[float, Kept(least=0, most=_LARGEST)]


@dataclass(frozen=True, slots=True, eq=False)
class FeatureScaling:
    """Features s / |s|^damping of readings x, with s = sgn(x) min(|x|, ceiling)^exponent.

    Parameters
    ----------
    ceiling : (m,) ceiling in the readings' unit.
    """

    exponent: _Positive
    damping: _Positive
    ceiling: Annotated[Array, Kept(units="reading", dims="readings", least=0, most=_LARGEST)]


@dataclass(frozen=True, slots=True, eq=False)
class PatternTurns:
    """Turns and mirrors of a sheet's electrodes under which a pattern of readings stays itself.

    Parameters
    ----------
    permuted : (g, m) reading that each one becomes; ``signs`` (g, m) with which sign.
    turns : (g, 2, 2) the same turns of places in the electrodes' axes, electrode e of N at the angle 2π e/N.
    """

    permuted: Annotated[Indices, Kept(dims="turns readings")]
    signs: Annotated[Array, Kept(single=True, dims="turns readings", least=-1, most=1)]
    turns: Annotated[Array, Kept(dims="turns 2 2", least=-1, most=1)]

    def __len__(self) -> int:
        return len(self.turns)

    def turn_back(self, features: Array, turn: int) -> Array:
        """Features (n, m) of the same presses on a sheet turned back."""
        turned: Array = features[:, self.permuted[turn]] * self.signs[turn]
        return turned

    def turn_forth(self, features: Array, turn: int) -> Array:
        """Features (n, m) of the same presses on the sheet turned."""
        turned = np.empty_like(features)
        turned[:, self.permuted[turn]] = features * self.signs[turn]
        return turned

    def orbits(self) -> Indices:
        """Number of the set (m,) of readings that become each other; sets are numbered from 0."""
        return np.unique(self.permuted.min(axis=0), return_inverse=True)[1].astype(np.int64)


@dataclass(frozen=True, slots=True, eq=False)
class PlaceScales:
    """Hyperparameters: variances of a part of its own, one that turns with the sheet, and of what remains.

    Parameters
    ----------
    own, turning : (m,) inverse squared lengths of features.
    """

    own_variance: Annotated[float, Kept(units="mm^2", least=0, most=_LARGEST)]
    turning_variance: Annotated[float, Kept(units="mm^2", least=0, most=_LARGEST)]
    noise_variance: Annotated[float, Kept(units="mm^2", least=0, most=_LARGEST)]
    own: Annotated[Array, Kept(dims="readings", least=0, most=_LARGEST)]
    turning: Annotated[Array, Kept(dims="readings", least=0, most=_LARGEST)]


@dataclass(frozen=True, slots=True, eq=False)
class PlaceProcess:
    """A Gaussian process from features to places, given presses.

    Parameters
    ----------
    features : (n, m) features of the presses.
    places_mm : (n, 2) places of the presses.
    weights : (n, 2) K⁻¹y [1/mm].
    """

    scales: PlaceScales
    features: Annotated[Array, Kept(single=True, dims="presses readings", most=_LARGEST)]
    places_mm: Annotated[Array, Kept(single=True, dims="presses 2", most=_LARGEST)]
    weights: Annotated[Array, Kept(units="1/mm", single=True, dims="presses 2", most=_LARGEST)]


@dataclass(frozen=True, slots=True, eq=False)
class PlaceTemplates:
    """Expected features over a grid.

    Parameters
    ----------
    grid_mm : (k, 2).
    whitening : (m, m) lower factor W of the inverse covariance of features about their templates.
    templates : (k, m) expected features times W.
    uncertainty : (k,) variance of a template, in units of that of a press.
    """

    grid_mm: Annotated[Array, Kept(single=True, dims="nodes 2", most=_LARGEST)]
    whitening: Annotated[Array, Kept(single=True, dims="readings readings", most=_LARGEST)]
    templates: Annotated[Array, Kept(single=True, dims="nodes readings", most=_LARGEST)]
    uncertainty: Annotated[Array, Kept(single=True, dims="nodes", least=0, most=_LARGEST)]


@dataclass(frozen=True, slots=True, eq=False)
class PlaceMixture:
    """Mixture of both estimates, and the distance that the place may have from it.

    Parameters
    ----------
    share : share of the templates' estimate.
    spread : (3,) weights in the covariance Σ of a place: of the templates' own, of 1 mm², and of the squared
        distance between both estimates.
    quantiles : (2,) quantiles of dᵀΣ⁻¹d that hold 68 and 95 % of presses that were left out.
    """

    share: _Positive
    spread: Annotated[Array, Kept(dims="3", least=0, most=_LARGEST)]
    quantiles: Annotated[Array, Kept(dims="2", least=0, most=_LARGEST)]


@dataclass(frozen=True, slots=True, eq=False)
class ModelledPlace:
    """Model of the touched place on the modelled sheet: weak loads on a lattice of the registered sheet.

    Parameters
    ----------
    node : (k, 2) columns and rows from the sheet's centre, in its axes.
    step_mm : distance between nodes, on the sheet.
    templates : (k, m) changes of the readings per strength; zero of those that do not answer.
    variance_mm2 : variance of a place along an axis [mm²], from the presses that the sheet was registered with.
    widening : factor of covariances, so that regions of the learned places' quantiles hold those presses.
    noise : standard deviation of a reading's noise, root mean square; 0 if unknown.
    """

    node: Annotated[Indices, Kept(dims="nodes 2", least=-_LARGEST_NODE, most=_LARGEST_NODE)]
    step_mm: _Positive
    templates: Annotated[Array, Kept(single=True, dims="nodes readings", most=_LARGEST)]
    variance_mm2: Annotated[float, Kept(units="mm^2", least=0, most=_LARGEST)]
    widening: _Positive
    noise: Annotated[float, Kept(units="reading", least=0, most=_LARGEST)]


@dataclass(frozen=True, slots=True, eq=False)
class LearnedPlace:
    """Model of the place where a sheet is pressed, from a frame's changes.

    Parameters
    ----------
    centre_mm : (2,) centre of the sheet in the frame of the presses.
    axes : (2, 2) orthogonal A: a place p is A (p − centre) in the electrodes' axes.
    misfit : largest squared misfit per reading of a touch like those learned from.
    least_size : smallest root mean square of the readings that is a touch, in their unit.
    reach_mm : largest distance from the nearest press that was learned from.
    """

    scaling: FeatureScaling
    turns: PatternTurns
    process: PlaceProcess
    templates: PlaceTemplates
    mixture: PlaceMixture
    centre_mm: Annotated[Array, Kept(dims="2", most=_LARGEST)]
    axes: Annotated[Array, Kept(dims="2 2", least=-1, most=1)]
    misfit: _Positive
    least_size: Annotated[float, Kept(units="reading", least=0, most=_LARGEST)]
    reach_mm: _Positive


@dataclass(frozen=True, slots=True, eq=False)
class PlaceOfRun:
    """Place as learned from the presses of a run, kept because it was clearly better than the model of the sheet.

    Parameters
    ----------
    learned : place learned from the rows of :attr:`~cbsr_qa.domain.results.ForceModel.merging`, as readings [V], on
        the sheet.
    presses : number it was learned from.
    error_mm, modelled_error_mm : mean distance of found from pressed places of presses left out, and of the same
        presses by the force model's templates; ``gain_stderr_mm`` of their difference.
    """

    learned: Annotated[LearnedPlace, Kept("")]
    presses: Annotated[int, Kept(units="1")]
    error_mm: _Positive
    modelled_error_mm: _Positive
    gain_stderr_mm: _Positive
