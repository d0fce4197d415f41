"""Effect of one head on the readings at every possible place: the bank of templates for frames."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from math import ceil, log, sqrt
from typing import Final

import numpy as np

from cbsr_qa.domain.errors import CalibrationError
from cbsr_qa.domain.numbers import Array, Indices, Mask
from cbsr_qa.domain.readings.loads import Indenter
from cbsr_qa.domain.results.calibration import ForceModel, Lattice
from cbsr_qa.eit.estimate.readings import MergedReadings
from cbsr_qa.eit.loads.round_load import LoadReadings, RoundLoadModel, RoundLoads

#: Contrast of the templates: readings per strength differ by less than 0.3 % up to 0.3 within 36 mm of the centre of
#: the 100 mm disc, and by 1.4 % at 40 mm.
CONTRAST: Final = 0.1
#: Spacing of the lattice's places, in radii of the sheet: 1.25 mm on the 100 mm disc.
SPACING: Final = 0.025
#: Nodes closer to an edge or an electrode [of the sheet's radius] have no field for interpolation.
LEAST_CLEARANCE: Final = 0.03
#: Discs up to this share of the clearance can be expanded about their centre; larger heads are extrapolated from
#: there.
_CLEAR_OF: Final = 0.92
_AT_ONCE: Final = 128
#: Share of a residue before a press that remains at its steady frames, with its uncertainty. Material relaxations are
#: almost over by then and slow residues almost unchanged: chosen by us, between the two.
RESIDUE_SHARE: Final = 0.3
RESIDUE_STDERR: Final = 0.15
#: Least share of a load's signal explained by a second head for a frame to count as one of several.
LEAST_MISFIT: Final = 5e-4
#: False alarm probability per frame.
_FALSE_ALARMS: Final = 1e-4


@dataclass(frozen=True, slots=True, eq=False)
class TemplateBank:
    """Rows of unit noise per strength 2κ/(2 + κ), by place.

    Parameters
    ----------
    lattice, node : places, and the row of each, or −1.
    places_mm : (n, 2) places of the rows.
    templates, log_size, size_slope, slopes, fits : fields of :class:`~cbsr_qa.domain.results.calibration.ForceModel`.
    """

    lattice: Lattice
    node: Indices
    places_mm: Array
    templates: Array
    log_size: Array
    size_slope: Array
    slopes: Array
    fits: Mask


def template_bank(model: RoundLoadModel, readings: MergedReadings, head: Indenter) -> TemplateBank:
    """Compute the readings of a head at every place of a lattice over the sheet.

    If a head is too close to an edge or an electrode for an expansion about its centre, the field of the largest
    possible disc is extrapolated linearly in the squared radius; those nodes serve for interpolation.

    CalibrationError if the head fits nowhere on the sheet.

    Parameters
    ----------
    readings : merging of readings into rows.
    head : head of any outline; the disc of its area and second moment replaces it.
    """
    lattice = _lattice(model)
    lattice_mm = lattice.places_mm()
    clear_mm = model.surroundings.clearance_mm(lattice_mm)
    inside_mask = clear_mm >= LEAST_CLEARANCE * model.surroundings.radius_mm
    if not (clear_mm >= head.radius_mm).any():
        raise CalibrationError(f"a head of {head.words()} fits nowhere on the sheet: no force can be calibrated")
    node = np.where(inside_mask, np.cumsum(inside_mask) - 1, -1).reshape(lattice.rows, lattice.columns)
    places = lattice_mm[inside_mask]
    parts = zip(*(_templates(readings, pressed) for pressed in _press_everywhere(model, head)), strict=True)
    templates, log_size, size_slope, slopes = (np.concatenate(values) for values in parts)
    fits = clear_mm[inside_mask] >= head.radius_mm
    return TemplateBank(lattice, node.astype(np.int64), places, templates, log_size, size_slope, slopes, fits)


@lru_cache(maxsize=1)  # keeps those of the last sensor and head, about 50 MB
def _press_everywhere(model: RoundLoadModel, head: Indenter) -> "tuple[_Pressed, ...]":
    """Readings of a head at all places of the lattice, independent of measurements."""
    lattice_mm = _lattice(model).places_mm()
    inside_mask = model.surroundings.clearance_mm(lattice_mm) >= LEAST_CLEARANCE * model.surroundings.radius_mm
    return tuple(_press_lattice(model, lattice_mm[inside_mask], head))


@dataclass(frozen=True, slots=True, eq=False)
class _Pressed:
    """Readings of a head at some places, and the excess of its squared radius over the expandable one."""

    readings: LoadReadings
    beyond_mm2: Array
    square_mm2: float


def _press_lattice(model: RoundLoadModel, places_mm: Array, head: Indenter) -> "Iterator[_Pressed]":
    square, strength = head.squared_radius_mm2, CONTRAST / (2 + CONTRAST) * head.area_mm2 / np.pi
    for first in range(0, len(places_mm), _AT_ONCE):
        places = places_mm[first : first + _AT_ONCE]
        reached = np.minimum(square, (_CLEAR_OF * model.surroundings.clearance_mm(places)) ** 2)
        loads = RoundLoads(places, np.full(len(places), strength), reached)
        yield _Pressed(model.readings(loads), square - reached, square)


def _lattice(model: RoundLoadModel) -> Lattice:
    spacing = SPACING * model.surroundings.radius_mm
    low_x, high_x, low_y, high_y = model.surroundings.extent_mm
    # Relative to the middle, so that a symmetric sheet has a symmetric lattice.
    half_counts = [ceil((high - low) / 2 / spacing) for low, high in ((low_x, high_x), (low_y, high_y))]
    x, y = (low_x + high_x) / 2, (low_y + high_y) / 2
    return Lattice(
        (x - half_counts[0] * spacing, y - half_counts[1] * spacing),
        spacing,
        2 * half_counts[0] + 1,
        2 * half_counts[1] + 1,
    )


def _templates(readings: MergedReadings, pressed: _Pressed) -> tuple[Array, Array, Array, Array]:
    per = 2 * CONTRAST / (2 + CONTRAST)
    by_x, by_y, _, by_square = (readings.merge_frames(pressed.readings.slope[:, k]) / per for k in range(4))
    rows = readings.merge_frames(pressed.readings.change) / per + by_square * pressed.beyond_mm2[:, None]
    size = np.linalg.norm(rows, axis=1)
    rows, by_x, by_y, by_square = (values / size[:, None] for values in (rows, by_x, by_y, by_square))
    projections = [(rows * slope_rows).sum(axis=1) for slope_rows in (by_x, by_y)]
    turn_x, turn_y = (
        slope_rows - rows * projection[:, None]
        for slope_rows, projection in zip((by_x, by_y), projections, strict=True)
    )
    pairs = ((turn_x, turn_x), (turn_x, turn_y), (turn_y, turn_y))
    slopes = np.column_stack([*projections, *((slope * other).sum(axis=1) for slope, other in pairs)])
    return rows, np.log(size), by_square * pressed.square_mm2, slopes


def make_even_model(bank: TemplateBank, merging: Array) -> ForceModel:
    """Return the force model of an even sheet, before learning from loads."""
    zeros = np.zeros(len(bank.templates))
    return ForceModel(
        lattice=bank.lattice,
        node=bank.node,
        merging=merging,
        templates=bank.templates,
        log_size=bank.log_size,
        size_slope=bank.size_slope,
        log_size_gradient=bank.slopes[:, :2],
        turning=bank.slopes[:, 2:],
        fits=bank.fits,
        log_response=zeros,
        log_response_stderr=zeros,
        scatter=0.0,
        stress_kPa=(0.0, 0.0),
        threshold=_threshold(bank),
        misfit=LEAST_MISFIT,
        residue_share=RESIDUE_SHARE,
        residue_stderr=RESIDUE_STDERR,
    )


def _threshold(bank: TemplateBank) -> float:
    """Detectability that noise reaches at the best of all places in one of 10 000 frames.

    The expected number of places where a smooth Gaussian field of unit variance over an area A exceeds ±u is
    2 A √|Λ| (2π)^(−3/2) u e^(−u²/2), Λ the products of its slopes (Adler 1981, 6.9): that many by chance, and
    a few along the edge.
    """
    xx, xy, yy = bank.slopes[bank.fits][:, 2:].T
    turns = float(np.sqrt(np.maximum(xx * yy - xy**2, 0.0)).sum()) * bank.lattice.spacing_mm**2
    level = sqrt(2 * log(1 / _FALSE_ALARMS))
    for _ in range(20):
        expected = 2 * turns * (2 * np.pi) ** -1.5 * level
        level = sqrt(2 * log(max(expected, 1.0) / _FALSE_ALARMS))
    return level
