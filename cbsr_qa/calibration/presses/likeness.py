"""Likeness of a press's readings to those of a modelled load at each place of the sheet."""

from copy import copy
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.ndimage import distance_transform_edt

from cbsr_qa.calibration.place import log_likelihood, most_alike, unit_rows
from cbsr_qa.calibration.presses.weak_loads import STEP, ModelledSheet
from cbsr_qa.domain import Array, Indices, Mask

#: Readings of one modelled polarity hardly respond if those of the other are larger by this factor, both relative to
#: the modelled sheet.
_DEAD: Final = 3.0
#: Log likelihood of a press off the sheet.
_OFF_SHEET: Final = -1.0


@dataclass(frozen=True, slots=True, eq=False)
class AnsweringSide:
    """Readings that respond to a press.

    Parameters
    ----------
    answers : (m,) False for those that never do, and those of a polarity that hardly responds.
    words : description; empty if both polarities respond.
    """

    answers: Mask
    words: str = ""


def answering_side(sheet: ModelledSheet, pairs: Indices, changes: Array) -> AnsweringSide:
    """Find whether readings of one modelled polarity hardly respond, as behind a rectifying front end.

    Parameters
    ----------
    sheet : as modelled.
    pairs : (m, 4) of the readings.
    changes : (n, m) of the presses, any unit.
    """
    alive: Mask = np.any(changes != 0, axis=0)
    modelled = np.median(np.abs(sheet.lattice.readings(pairs)), axis=0)
    answer = np.median(np.abs(changes), axis=0) / np.maximum(modelled, np.finfo(np.float64).tiny)
    side = compared_sides(answer, sheet.unloaded(pairs) > 0)
    return AnsweringSide(alive & side.answers, side.words)


def compared_sides(answer: Array, positive: Mask) -> AnsweringSide:
    """Compare readings of both modelled polarities.

    Parameters
    ----------
    answer : (m,) size of each reading over the modelled one, any unit.
    positive : (m,) whether its modelled voltage is.
    """
    if positive.all() or not positive.any():
        return AnsweringSide(np.ones_like(positive))
    sizes = [float(np.median(answer[side])) for side in (positive, ~positive)]
    if max(sizes) <= _DEAD * min(sizes):
        return AnsweringSide(np.ones_like(positive))
    dead, name = (~positive, "negative") if sizes[0] > sizes[1] else (positive, "positive")
    words = (
        f"{int(dead.sum())} readings whose modelled voltage is {name} hardly respond: {min(sizes) / max(sizes):.1%}"
        " of what the others do, both compared with the modelled sheet; the front end appears to rectify"
    )
    return AnsweringSide(~dead, words)


def alikeness(changes: Array, templates: Array) -> Array:
    """Cosines of changes (n, m) and templates (…, m) where the shapes broadcast, both compressed: (…)."""
    cosines: Array = np.einsum("...m,...m->...", unit_rows(changes), unit_rows(templates))
    return cosines


class Likeness:
    """Log likelihoods of presses by place, on the sheet's lattice.

    Parameters
    ----------
    sheet : as modelled.
    pairs : (m, 4) of the readings.
    changes : (n, m) of presses, with the sign of a rise of conductance.
    """

    def __init__(self, sheet: ModelledSheet, pairs: Indices, changes: Array) -> None:
        lattice = sheet.lattice
        self._node, self._alike = lattice.node, unit_rows(changes) @ unit_rows(lattice.readings(pairs)).T
        self._centre = int(np.abs(self._node).max()) + 2  # two more than are on the sheet, for cubic interpolation
        self._width = 2 * self._centre + 1
        rows, columns = (self._node + self._centre).T
        self._on_sheet = np.zeros((self._width, self._width))
        self._on_sheet[rows, columns] = 1.0
        maps = np.zeros((len(changes), self._width, self._width))
        maps[:, rows, columns] = self._alike
        nearest = distance_transform_edt(self._on_sheet == 0, return_distances=False, return_indices=True)
        self._maps = maps[:, *nearest]
        self._rough = np.where(self._on_sheet > 0, log_likelihood(self._maps), _OFF_SHEET)

    def of(self, presses: Indices) -> "Likeness":
        """The same for some of the presses."""
        some = copy(self)
        some._maps, some._alike = self._maps[presses], self._alike[presses]
        some._rough = self._rough[presses]
        return some

    def roughly(self, places: Array) -> Array:
        """As :meth:`at`, linear between nodes and a fifth of the time: to choose where to begin."""
        (x, y), first = self._between(places)
        flat, width = self._rough.ravel(), self._width
        near = (1 - y) * flat.take(first) + y * flat.take(first + 1)
        far = (1 - y) * flat.take(first + width) + y * flat.take(first + width + 1)
        value: Array = (1 - x) * near + x * far
        return value

    def at(self, places: Array) -> Array:
        """Log likelihoods (…, n) of each press at its place (…, n, 2), in radii.

        Cosines are cubic between nodes: interpolated linearly, likelihoods would be largest at nodes, and presses on
        a grid would be found on one of the lattice, however far apart they are. Beyond the sheet they fade linearly.
        """
        (x, y), node = self._between(places)
        flat, width = self._maps.ravel(), self._width
        first = node - width - 1
        along, across = _cubic(x), _cubic(y)
        alike = np.zeros_like(x)
        for m, a in enumerate(along):
            row = first + m * width
            alike += a * sum(b * flat.take(row + n) for n, b in enumerate(across))
        sheet, node = self._on_sheet.ravel(), node % width**2
        on = (1 - x) * ((1 - y) * sheet.take(node) + y * sheet.take(node + 1))
        on += x * ((1 - y) * sheet.take(node + width) + y * sheet.take(node + width + 1))
        value: Array = on * log_likelihood(alike) + (1 - on) * _OFF_SHEET
        return value

    def _between(self, places: Array) -> tuple[Array, Indices]:
        """How far places (…, n, 2) are beyond a node (2, …, n), and the number of that node in all maps (…, n)."""
        at = np.clip(places / STEP + self._centre, 1.0, self._width - 2.001)
        node = at.astype(np.int64)
        press = np.arange(len(self._maps))
        return np.moveaxis(at - node, -1, 0), (press * self._width + node[..., 0]) * self._width + node[..., 1]

    def best_places(self) -> Array:
        """Most likely place (n, 2) of each press, in radii, interpolated by parabolas."""
        return STEP * most_alike(self._node, self._alike)


def _cubic(t: Array) -> tuple[Array, Array, Array, Array]:
    """Weights of four nodes for a point between the inner two, at t (Keys 1981, with a = -1/2)."""
    return (
        t * (-0.5 + t * (1 - 0.5 * t)),
        1 + t**2 * (1.5 * t - 2.5),
        t * (0.5 + t * (2 - 1.5 * t)),
        t**2 * (t - 1) / 2,
    )
