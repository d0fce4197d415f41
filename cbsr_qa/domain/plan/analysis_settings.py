"""Settings of a recipe for the evaluation of a run."""

from dataclasses import dataclass

from cbsr_qa.domain.imaging import OverlapBand
from cbsr_qa.domain.plan.batch_model import KeptBatch


@dataclass(frozen=True, slots=True)
class AnalysisSettings:
    """Settings of the image analysis: every choice the paper leaves open.

    Parameters
    ----------
    masks : percentage masks to report, as fractions.
    main_mask : the one the verdict uses; must be among ``masks``.
    noise_floor_frames : unloaded frames for the noise floor (the paper's first eight).
    reference : ``"run"`` (mean of the rested frames without the noise-floor ones) or ``"load"`` (before each press).
    reference_frames : frames before each press that ``"load"`` averages.
    steady_frames : largest number of frames at the end of a hold that make the steady image.
    settling_multiple : a hold is settled from this multiple of the settling time on.
    settling_tolerance : half width of the settling band.
    settling_band : ``"steady"`` (of the steady change) or ``"step"`` (of the relaxing part).
    r_squared_gate : fits below are rejected.
    overlap_bands : names of the area-overlap scale.
    size_ratio : lowest and highest A_b/A_FA for which a band counts.
    clipping : ``"exact"`` or ``"centroid"``.
    perimeter : ``"length"`` or ``"nodes"``.
    outline : outline of a sensed region: ``"contour"`` (inside the elements) or ``"elements"`` (whole ones, the
        paper's).
    noise_weighting : ``"equal"`` (all readings count alike) or ``"measured"`` (by their noise when unloaded).
    calibrate_phases : names of the phases whose loads calibrate; those of others test the calibration.
    transients : treatment of short holds for the force model: ``"averaged"`` (their last frames as measured) or
        ``"predicted"`` (extrapolated to the end of the run's longest holds).
    learn_place : whether place is learned from the loads that calibrate, and used if that pays.
    prior : what is known of a sensor's map before its presses: ``"none"``, or ``"batch"``, what its batch has in
        common.
    batch : the batch's model, which a run's configuration holds; None without.
    """

    masks: tuple[float, ...]
    main_mask: float
    noise_floor_frames: int
    reference: str
    reference_frames: int
    steady_frames: int
    settling_multiple: float
    settling_tolerance: float
    settling_band: str
    r_squared_gate: float
    overlap_bands: tuple[OverlapBand, ...]
    size_ratio: tuple[float, float]
    clipping: str
    perimeter: str
    outline: str
    noise_weighting: str = "equal"
    calibrate_phases: tuple[str, ...] = ()
    transients: str = "averaged"
    learn_place: bool = False
    prior: str = "none"
    batch: KeptBatch | None = None


@dataclass(frozen=True, slots=True)
class CharacterisationSettings:
    """Settings for the evaluation of cycles on a strip.

    Parameters
    ----------
    contact_length_mm, contact_length_stderr_mm : contact impedance of the pins over the sheet resistance, which two
        pins cannot measure, and its standard error.
    settling_tolerance, settling_band : tolerance and band as in
        :class:`~cbsr_qa.domain.plan.analysis_settings.AnalysisSettings`.
    end_s : length of the end of a hold or a rest, in which levels are taken as they were read [s].
    """

    contact_length_mm: float = 0.2
    contact_length_stderr_mm: float = 0.1
    settling_tolerance: float = 0.15
    settling_band: str = "steady"
    end_s: float = 10.0
