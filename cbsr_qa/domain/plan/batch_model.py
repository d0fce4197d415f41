"""A batch's model as it is kept: the runs it rests on with their loads, its hyperparameters, and how loads relax."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class KeptSensor:
    """One sensor of the model.

    Parameters
    ----------
    run, chain_head : its run, and the digest of the last link of that run's chain.
    places_mm : places of its loads.
    log_response, variance : logarithm of the observed change over that of the line, and its variance by noise.
    bend, bend_stderr : effect of a wrong intercept of the line, and the prior standard deviation of its multiple.
    """

    serial: str
    run: str
    chain_head: str
    places_mm: tuple[tuple[float, float], ...]
    log_response: tuple[float, ...]
    variance: tuple[float, ...]
    bend: tuple[float, ...] | None = None
    bend_stderr: float = 1.0


@dataclass(frozen=True, slots=True)
class KeptMember:
    """One choice of the hyperparameters, as in :mod:`cbsr_qa.calibration.batch.likelihood`, and its weight."""

    smooth: bool
    length_mm: float
    scatter: float
    own: float
    common: float
    level: float
    weight: float


@dataclass(frozen=True, slots=True)
class KeptKernel:
    """Relaxation of the batch's loads; fields as in :class:`~cbsr_qa.domain.results.relaxation.RelaxationKernel`."""

    loading: bool
    weights: tuple[float, ...]
    time_constants_s: tuple[float, ...]
    covariance: tuple[tuple[float, ...], ...]
    scatter: tuple[float, ...]
    scatter_freedom: float
    loads: int
    start_s: float


@dataclass(frozen=True, slots=True)
class KeptRelaxation:
    """How loads of the batch relax, from the longest holds of its runs.

    Parameters
    ----------
    hold_s, steady_s : how long these were held, and the time after the press at which they were evaluated.
    strength, stress : kernels of the conductance under the head, and of the force.
    unloading : kernel of the conductance after a release; None if it was not determined.
    """

    hold_s: float
    steady_s: float
    strength: KeptKernel
    stress: KeptKernel
    unloading: KeptKernel | None = None


@dataclass(frozen=True, slots=True)
class KeptBatch:
    """A batch's model.

    Parameters
    ----------
    layout : version of the document's layout.
    digest : SHA-256 of the method, the runs and their chains.
    content_sha256 : SHA-256 of everything else in canonical JSON.
    head_mm, radius_mm : diameter of the head, and radius of the sheet.
    level_drift : change of the level of the response from one sensor to the next, relative; 0 where none is shown.
    relaxation : None where the runs have no long holds that determine it.
    """

    layout: int
    digest: str
    content_sha256: str
    batch: str
    sensor_type: str
    material: str
    head_mm: float
    radius_mm: float
    sensors: tuple[KeptSensor, ...]
    members: tuple[KeptMember, ...]
    level_drift: float = 0.0
    relaxation: KeptRelaxation | None = None
