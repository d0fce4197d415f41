"""Loads estimated from the readings, without an image."""

from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from cbsr_qa.domain.numbers import Array


class LoadFinding(StrEnum):
    """Result of locating a load."""

    LOCATED = "located"
    NOT_DETECTED = "not detected"  #: no signal above the noise of the readings
    NOT_RESOLVABLE = "not resolvable"  #: there is a load, but too weak to say where
    NOT_AS_MODELLED = "not as modelled"  #: no round load on the modelled sheet explains the readings


@dataclass(frozen=True, slots=True)
class Estimated:
    """A number with its uncertainty.

    Parameters
    ----------
    value : the estimate.
    stderr : standard error.
    low, high : 68 % interval; not symmetric about the value where the standard error itself depends on it.
    """

    value: float
    stderr: float
    low: float
    high: float


@dataclass(frozen=True, slots=True, eq=False)
class LoadEstimate:
    """One round load estimated from the readings, not from an image.

    Parameters
    ----------
    finding : everything but ``detectability``, misfit and shares is None unless the load was located.
    why : reason of a refusal, and what would help; empty otherwise.
    detectability : d′, the load's signal over the readings' noise (matched filter).
    place_mm : (x, y).
    place_covariance_mm2 : (2, 2); its 68 % region is the ellipse of Mahalanobis distance 1.52.
    area_contrast_mm2 : area × contrast, counted against the mean of both conductances: π r² · 2 Δγ/(γ + γ_i). It is
        determined whether the radius is or not; a weak load's equals π r² Δγ/γ.
    contrast : κ = Δγ/γ; only where the radius was given.
    radius_mm : None if it was given, or is not determined (``no_radius`` gives the reason).
    no_radius : why there is no radius; empty where there is one.
    misfit : sum of squared residuals over their number less that of the unknowns: 1 for a round load on such a sheet.
    misfit_probability : probability of a misfit at least as large, were the model right.
    inflation : factor on the covariance because of the misfit of the model; else 1.
    explained : share of the readings' signal that the load explains, weighed by their noise, which is taken off.
    explained_unweighted : the same of the readings' squares.
    """

    finding: LoadFinding
    why: str
    detectability: float
    place_mm: tuple[float, float] | None
    place_covariance_mm2: Array | None
    area_contrast_mm2: Estimated | None
    contrast: Estimated | None
    radius_mm: Estimated | None
    no_radius: str
    misfit: float
    misfit_probability: float
    inflation: float
    explained: float
    explained_unweighted: float
    steps: int

    @property
    def place_stderr_mm(self) -> float | None:
        """Standard error of the place, root mean square over two axes [mm]; None if not located."""
        covariance = self.place_covariance_mm2
        return None if covariance is None else float(np.sqrt(np.trace(covariance) / 2))
