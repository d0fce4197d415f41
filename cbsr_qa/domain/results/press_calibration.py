"""Calibrations from labelled presses: origin of the presses, pose of the sheet, and the models learned from them."""

from dataclasses import dataclass
from typing import Annotated, Final

import numpy as np

from cbsr_qa.domain.kept import NOT_KEPT, Kept
from cbsr_qa.domain.numbers import Array, Indices
from cbsr_qa.domain.plan.standards import ReferenceStandard
from cbsr_qa.domain.results.learned_place import LearnedPlace, ModelledPlace
from cbsr_qa.domain.results.learned_quantity import LearnedQuantity
from cbsr_qa.domain.results.signature import Signature

#: Quantities that presses may be labelled with beside their places, and their units.
PRESS_QUANTITIES: Final = {"force": "N", "depth": "mm"}

Pairs = tuple[tuple[int, int], ...]


@dataclass(frozen=True, slots=True)
class SheetRegistration:
    """Similarity from the sheet to the frame in which presses are labelled: p = shift + scale R(θ) M q.

    q is a place on the sheet in the axes of its sensor type, M turns (x, y) into (x, −y) where the sheet is mirrored.

    Parameters
    ----------
    rotation_deg : θ, counterclockwise.
    mirrored : whether the electrodes run the other way round than the sensor type says, as seen by the presses.
    scale : length in the frame of the presses over length on the sheet; 1 where the radius was estimated.
    shift_mm : sheet's centre in the frame of the presses [mm].
    radius_mm : radius of the sheet [mm]; as stated, with a standard error of zero, or estimated.
    place_share : share of the spread of the presses' places that the physical estimate explains, by medians; negative
        where it errs by more than the presses are apart.
    signal_share : share of the readings' changes that the modelled sheet explains at the registered places, median
        over the presses.
    trusted : whether the modelled sheet explains enough for the registration to be used; ``why`` says why not.
    """

    rotation_deg: float
    rotation_stderr_deg: float
    mirrored: bool
    scale: float
    scale_stderr: float
    shift_mm: tuple[float, float]
    shift_stderr_mm: tuple[float, float]
    radius_mm: float
    radius_stderr_mm: float
    place_share: Annotated[float, Kept(units="1")]
    signal_share: Annotated[float, Kept(units="1")]
    trusted: bool
    why: str = ""

    @property
    def axes(self) -> Array:
        """Orthogonal matrix (2, 2): turns the frame of the presses into the sheet's axes."""
        angle = np.radians(self.rotation_deg)
        turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
        axes: Array = np.array([[1.0], [-1.0 if self.mirrored else 1.0]]) * turn
        return axes

    def covariance_mm2(self, labelled_mm: Array) -> Array:
        """Covariance (n, 2, 2) that the pose's own errors give places (n, 2) in the frame of the presses."""
        about = labelled_mm - np.array(self.shift_mm)
        across = about @ np.array([[0.0, 1.0], [-1.0, 0.0]])
        stretch = np.hypot(self.scale_stderr / self.scale, self.radius_stderr_mm / self.radius_mm)
        spread: Array = np.diag(np.square(self.shift_stderr_mm)) + sum(
            error**2 * way[:, :, None] * way[:, None, :]
            for error, way in ((np.radians(self.rotation_stderr_deg), across), (stretch, about))
        )
        return spread

    def on_sheet_mm(self, places_mm: Array) -> Array:
        """Places (n, 2) on the sheet, from its centre, of places in the frame of the presses."""
        places: Array = (places_mm - np.array(self.shift_mm)) @ self.axes.T / self.scale
        return places

    def to_press_frame_mm(self, places_mm: Array) -> Array:
        """Places (n, 2) in the frame of the presses of places on the sheet, from its centre."""
        labelled: Array = self.scale * places_mm @ self.axes + np.array(self.shift_mm)
        return labelled


@dataclass(frozen=True, slots=True)
class SourceFile:
    """A file that a calibration was made from.

    Parameters
    ----------
    role : ``"readings"``, ``"presses"``, ``"pattern"``, ``"rest"``, ``"sensor type"`` or ``"standards"``.
    name : name of the file, without its folder.
    digest : SHA-256 of its bytes.
    """

    role: str
    name: str
    digest: str


@dataclass(frozen=True, slots=True)
class LeftOutPress:
    """A press that nothing was learned from.

    Parameters
    ----------
    row : row of the tables, counted from 1 below the header.
    why : reason in words.
    """

    row: Annotated[int, Kept(units="index")]
    why: str


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class PressCalibration:
    """Calibration of one sensor from labelled presses.

    Parameters
    ----------
    calibration : time-ordered UUID as text.
    issued_at : ISO time with zone.
    made_by : statement that no station made it.
    sensor_type : name of the sensor type; ``electrodes`` how many it has.
    sources : the files it was made from.
    differences : whether the readings were changes already; else changes are against ``rest``.
    pairs : (m, 4) source, sink, plus and minus of each reading, as the pattern names them.
    repeats : (m,) columns of the table that each reading is the mean of.
    rest : (m,) mean of the unloaded frames; None where the readings were changes.
    noise : (m,) standard deviation of one frame about it; None where fewer than two frames were given.
    registration : pose of the sheet in the frame of the presses.
    findings : about readings, electrodes and sheet, in words.
    used, left_out : presses that it was learned from and those it was not.
    held_out_mm, held_out_stderr_mm, held_out : mean error of place of presses left out, its standard error and their
        number.
    covered_68, covered_95 : share of these whose region of that probability holds the label; None if too few presses
        tell how wide regions are.
    place : model that converts changes to places.
    modelled : figures by the modelled sheet alone.
    force, depth : models that turn located changes into newtons and millimetres; None where presses had none.
    standards : reference standards of the presses; those that are missing were not stated.
    drive, measure : pairs by row and column of a frame of the sensor type.
    digest, record_digest, file, signature : digests, file and signature as in
        :class:`~cbsr_qa.domain.results.calibration.Calibration`.
    """

    calibration: Annotated[str, Kept("identity/calibration")]
    issued_at: Annotated[str, Kept("identity/issued_at")]
    made_by: Annotated[str, Kept("identity/made_by")]
    sensor_type: Annotated[str, Kept("identity/sensor_type")]
    electrodes: Annotated[int, Kept("identity/electrodes")]
    sources: Annotated[tuple[SourceFile, ...], Kept("identity/sources/")]
    differences: Annotated[bool, Kept("readings/differences")]
    pairs: Annotated[Indices, Kept("readings/pairs", dims="readings 4")]
    repeats: Annotated[Indices, Kept("readings/repeats", "1", dims="readings")]
    rest: Annotated[Array | None, Kept("readings/rest")]
    noise: Annotated[Array | None, Kept("readings/noise")]
    registration: SheetRegistration
    findings: tuple[str, ...]
    used: Annotated[int, Kept("presses/used", "1")]
    left_out: Annotated[tuple[LeftOutPress, ...], Kept("presses/left_out/")]
    held_out_mm: Annotated[float | None, Kept("held_out/error")]
    held_out_stderr_mm: Annotated[float | None, Kept("held_out/error_stderr")]
    held_out: Annotated[int, Kept("held_out/presses", "1")]
    covered_68: Annotated[float | None, Kept("held_out/covered_68")]
    covered_95: Annotated[float | None, Kept("held_out/covered_95")]
    place: LearnedPlace
    drive: Annotated[Pairs, Kept("readings/drive")]
    measure: Annotated[Pairs, Kept("readings/measure")]
    modelled: ModelledPlace | None = None
    force: Annotated[LearnedQuantity | None, Kept(units="N")] = None
    depth: Annotated[LearnedQuantity | None, Kept(units="mm")] = None
    standards: Annotated[tuple[ReferenceStandard, ...], Kept("standards/", since=5)] = ()
    digest: Annotated[str, NOT_KEPT] = ""
    record_digest: Annotated[str, NOT_KEPT] = ""
    file: Annotated[bytes, NOT_KEPT] = b""
    signature: Annotated[Signature | None, NOT_KEPT] = None

    def __repr__(self) -> str:
        return f"<PressCalibration of a {self.sensor_type} from {self.used} presses, issued at {self.issued_at}>"
