"""What is issued from labelled presses: where they came from, how the sheet lies, and the place learned from them."""

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain.kept import Kept

Array = NDArray[np.float64]
Indices = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class SheetRegistration:
    """Similarity from the sheet to the frame in which presses are labelled: p = shift + scale R(θ) M q.

    q is a place on the sheet in the axes of its sensor type, M turns (x, y) into (x, −y) where the sheet is mirrored.

    Parameters
    ----------
    rotation_deg : θ, counterclockwise.
    mirrored : whether the electrodes run the other way round than the sensor type says, as seen by the presses.
    scale : length in the frame of the presses over length on the sheet; 1 where the radius was estimated.
    shift_mm : where the sheet's centre is in the frame of the presses.
    radius_mm : of the sheet; as stated, with a standard error of zero, or estimated.
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

    def on_sheet_mm(self, places_mm: Array) -> Array:
        """Places (n, 2) on the sheet, from its centre, of places in the frame of the presses."""
        z = (places_mm - np.array(self.shift_mm)) @ np.array([1, 1j])
        z = z * np.exp(-1j * np.radians(self.rotation_deg)) / self.scale
        places: Array = np.column_stack([z.real, -z.imag if self.mirrored else z.imag])
        return places

    def labelled_mm(self, places_mm: Array) -> Array:
        """Places (n, 2) in the frame of the presses of places on the sheet, from its centre."""
        z = places_mm @ np.array([1, -1j if self.mirrored else 1j])
        z = z * np.exp(1j * np.radians(self.rotation_deg)) * self.scale
        labelled: Array = np.column_stack([z.real, z.imag]) + np.array(self.shift_mm)
        return labelled


@dataclass(frozen=True, slots=True)
class SourceFile:
    """A file that a calibration was made from.

    Parameters
    ----------
    role : ``"readings"``, ``"presses"``, ``"pattern"``, ``"rest"`` or ``"sensor type"``.
    name : without its folder.
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
    row : of the tables, counted from 1 below the header.
    why : in words.
    """

    row: Annotated[int, Kept(units="index")]
    why: str
