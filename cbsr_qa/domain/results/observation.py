"""Observations of a load and of a run: the input of every metric plugin.

What the measurements say about one load: where, how large, how strong, and how surely.
"""

from collections.abc import Callable, Hashable
from dataclasses import dataclass, field
from typing import Any, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain.geometry.footprints import Footprint
from cbsr_qa.domain.imaging import Blob, Image, LinearReconstruction, Region
from cbsr_qa.domain.numbers import Array
from cbsr_qa.domain.plan.analysis_settings import AnalysisSettings
from cbsr_qa.domain.plan.standards import ReferenceStandard
from cbsr_qa.domain.plan.steps import Role
from cbsr_qa.domain.readings.frames import FrameBlock, SampleBlock
from cbsr_qa.domain.readings.loads import Indenter, LoadRecord
from cbsr_qa.domain.results.dimensions import Dimensions
from cbsr_qa.domain.results.relaxation import RelaxationFit, SettlingTime
from cbsr_qa.domain.run.run import RunRecord
from cbsr_qa.domain.sensor.sensor_type import Response

R = TypeVar("R")


@dataclass(frozen=True, slots=True, eq=False)
class Trace:
    """A quantity against time, e.g. a blob's mean conductance change through a press.

    Parameters
    ----------
    time_s, values : (n,) float64.
    """

    name: str
    unit: str
    time_s: Array
    values: Array

    @property
    def end_level(self) -> float:
        """Median of the last four values; 0 of an empty trace."""
        return float(np.median(self.values[-4:])) if len(self.values) else 0.0


@dataclass(frozen=True, slots=True, eq=False)
class RelaxationObservation:
    """A relaxation of one load: signal, direction, trace and fit.

    Parameters
    ----------
    signal : ``"conductance"``, ``"stress"``, ``"image"``.
    loading : True after the press, False after the release.
    trace : times from the end of the ramp.
    """

    signal: str
    loading: bool
    trace: Trace
    fit: RelaxationFit
    settling: SettlingTime


@dataclass(frozen=True, slots=True, eq=False)
class MaskView:
    """One percentage mask applied to the steady image of a load.

    Parameters
    ----------
    fraction : p, of the image's maximum.
    blobs : every blob, heaviest first; empty is "no blob".
    sensed : the blob nearest to the indenter (where several loads are held at once, the one assigned to this load);
        None without one. Amplitudes are taken over its elements.
    contour : the same bounded by a contour, where ``settings.outline`` asks for it; None elsewhere.
    fate : ``"apart"``, ``"merged"`` (its region is another load's too) or ``"missed"``.
    regions : number of regions there are, of which every load has at most one.
    """

    fraction: float
    blobs: tuple[Blob, ...]
    sensed: Blob | None
    contour: Region | None = None
    fate: str = "apart"
    regions: int = 1

    @property
    def region(self) -> Region | None:
        """Source of place, size and shape."""
        return self.sensed if self.contour is None else self.contour


@dataclass(frozen=True, slots=True, eq=False)
class LoadObservation:
    """One press: its steady image, its blobs, its force.

    Parameters
    ----------
    image : steady image, un-subtracted and not response-signed.
    response : sign that was applied before masking.
    noise_floor : relative, subtracted for masks only.
    masks : one view per percentage mask, in the recipe's order.
    steady_frames : number of frames that the steady image averages.
    settled : whether they lie at or beyond 1.5 × the settling time; None where no settling time is known.
    together : number of loads that were held while the steady frames were taken, this one included.
    force_N, force_stderr_N : mean over the same window; None where no force was recorded.
    residue : largest absolute value of the image just before the press: what earlier loads left behind, of
        either sign (an unloading spike goes the other way).
    alternate : the same load against the other reference (``settings.reference``), given where the residue
        exceeds the noise floor; None elsewhere.
    no_force : why there is no force although a load cell recorded one; empty elsewhere.
    """

    phase: str
    record: LoadRecord
    indenter: Indenter
    image: Image
    response: Response
    noise_floor: float
    masks: tuple[MaskView, ...]
    steady_frames: int
    settled: bool | None
    force_N: float | None
    force_stderr_N: float | None
    relaxations: tuple[RelaxationObservation, ...] = ()
    residue: float = 0.0
    together: int = 1
    alternate: Self | None = None
    no_force: str = ""

    @property
    def stress_kPa(self) -> float | None:
        """Mean stress under the head [kPa]; None without force."""
        return None if self.force_N is None else self.force_N / self.indenter.area_mm2 * 1e3

    @property
    def place_mm(self) -> tuple[float, float]:
        """Nominal axis of the head (x, y)."""
        return self.record.load.x_mm, self.record.load.y_mm

    @property
    def pressed(self) -> Footprint:
        """The head where it pressed."""
        return self.indenter.footprint_at(*self.place_mm)

    @property
    def hold_s(self) -> float:
        return self.record.release_start_s - self.record.hold_start_s

    def relaxation(self, signal: str, *, loading: bool) -> RelaxationObservation | None:
        """Return the relaxation of a signal after the press or after the release; None without one."""
        return next((r for r in self.relaxations if r.signal == signal and r.loading == loading), None)

    def mask(self, fraction: float) -> MaskView | None:
        """Return the view of one percentage mask, or None if the recipe does not use it."""
        return next((view for view in self.masks if abs(view.fraction - fraction) < 1e-9), None)


@dataclass(frozen=True, slots=True, eq=False)
class LoopObservation:
    """Loops pressed at one place of a phase: strains reached from below and from above.

    Parameters
    ----------
    records : records of the loops, in time order.
    output : amplitude of every frame along the pattern that all of them share, 1 at the deepest strain, on the run's
        clock from the first press to the end of the last rest.
    noise : standard deviation of the output of a single frame of the unloaded sheet.
    stress : every force sample over the same time as stress under the head [kPa]; None where no force was recorded.
    no_force : why there is no stress although a load cell recorded one; empty elsewhere.
    why : nothing was sensed, for this reason; empty where it was.
    """

    phase: str
    records: tuple[LoadRecord, ...]
    output: Trace
    noise: float
    stress: Trace | None
    no_force: str = ""
    why: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class MetricTimeline:
    """Spatial metrics of every frame of a phase, for each mask (the paper's Figs 10 and E.23).

    Parameters
    ----------
    time_s : (n,) float64 on the run's clock.
    masks : k fractions.
    error_mm, overlap_percent, deviation_mm2 : (k, n) float64, NaN while nothing is pressed or no blob is seen.
    force : samples over the same time; None where not recorded.
    """

    phase: str
    time_s: Array
    masks: tuple[float, ...]
    error_mm: Array
    overlap_percent: Array
    deviation_mm2: Array
    force: SampleBlock | None


@dataclass(frozen=True, slots=True, eq=False)
class RunObservation:
    """All results of a run that metrics may use.

    Parameters
    ----------
    reconstruction : the matrix used throughout.
    scale : s of :class:`LinearReconstruction`, V per unit-model V [A·Ω].
    unloaded : frames of the rested sheet that set reference and noise floor.
    reference : (drives, measures) float64 V, the reference frame.
    noise_floor : relative.
    noise_images : (8, e) images the floor was taken from.
    response : response that was configured or decided, INCREASE or DECREASE.
    response_how : ``"configured"`` or how it was decided.
    main_mask : fraction the verdict uses (0.85), as in ``settings``.
    loads : every held press, in time order; without loops.
    usable : (drives, measures) bool, readings that were imaged.
    timelines : metrics of every frame, for the phases that press a grid of places.
    settings : settings by which images became numbers.
    loops : presses that were eased to other strains, by place.
    standards : reference standards of the station that measured; those that are missing were not stated.
    """

    record: RunRecord
    reconstruction: LinearReconstruction
    scale: float
    unloaded: FrameBlock
    reference: Array
    noise_floor: float
    noise_images: Array
    response: Response
    response_how: str
    main_mask: float
    loads: tuple[LoadObservation, ...]
    usable: NDArray[np.bool_]
    settings: AnalysisSettings
    warnings: tuple[str, ...] = ()
    timelines: tuple[MetricTimeline, ...] = ()
    loops: tuple[LoopObservation, ...] = ()
    standards: tuple[ReferenceStandard, ...] = ()
    _derived: dict[Hashable, Any] = field(default_factory=dict, init=False, repr=False)

    def derive(self, compute: Callable[..., R], *args: Hashable) -> R:
        """Return what a function makes of this run: computed on first use, and kept with the run from then on.

        Use it for results that are costly and that metrics, report sections and the calibration need several times. A
        run that is changed (``dataclasses.replace``) starts without any.

        Parameters
        ----------
        compute : called with this run and the arguments.
        """
        key = compute, args
        if key not in self._derived:
            self._derived[key] = compute(self, *args)
        result: R = self._derived[key]
        return result

    def mask_qualifier(self, fraction: float) -> str:
        """Qualifier of what is measured under a mask: empty for the main one, ``"mask 25 %"`` for another."""
        return "" if abs(fraction - self.main_mask) < 1e-9 else Dimensions(mask=fraction).text

    @property
    def frame_period_s(self) -> float:
        """Time from one unloaded frame to the next [s]."""
        return float(np.median(np.diff(self.unloaded.time_s)))

    @property
    def tested(self) -> tuple[LoadObservation, ...]:
        """Loads that test the sheet, without conditioning loads."""
        worked_in = {phase.name for phase in self.record.phases if phase.role is Role.PRECONDITIONING}
        return tuple(load for load in self.loads if load.phase not in worked_in)

    @property
    def weight_ratio(self) -> float:
        """Largest over smallest weight of a reading; 1 for equal weights."""
        variance = self.reconstruction.problem.noise_variance
        return 1.0 if variance is None else float(variance.max() / variance.min())
