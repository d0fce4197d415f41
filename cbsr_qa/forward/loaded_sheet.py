"""Voltages of a sheet under many loads of known shapes, whose strengths change all the time.

As :class:`~cbsr_qa.forward.local.LocalUpdate`, with which it agrees to eight digits, for sequences of frames: what a
load answers to the fields about it is tabulated over its strength (:mod:`cbsr_qa.forward.load_family`), contacts are
eliminated once for many strengths, and of the fields that reach a rim those below a part in 10⁸ are left out. A
frame of nine loads is then a system of some two hundred.
"""

from collections import OrderedDict
from collections.abc import Hashable, Mapping, Sequence
from typing import Final, TypeVar

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.forward.inverse import InverseEntries
from cbsr_qa.forward.linked_patches import LinkedPatches
from cbsr_qa.forward.load_family import LoadFamily, Patch
from cbsr_qa.forward.local import LocalUpdate
from cbsr_qa.forward.model import ForwardModel
from cbsr_qa.forward.patches import ContactStack

Array = NDArray[np.float64]
Indices = NDArray[np.int64]
Kept = TypeVar("Kept", Patch, LinkedPatches | None)

_MOST_PATCHES: Final = 192  # some 0.3 MB each; of many loads that overlap tens of times that
_MOST_LINKS: Final = 24
_MOST_BYTES: Final = 96 << 20  # of either
_MOST_WORK: Final = 2e7  # cubes of the patches' elements, which have some two nodes each of their own


class LoadedSheet:
    """Transfer impedances of a model under loads.

    Parameters
    ----------
    model : the unloaded sheet.
    """

    def __init__(self, model: ForwardModel) -> None:
        self.model = model
        self._local = LocalUpdate(model)
        self._inverse = InverseEntries(model)
        self._contacts = ContactStack(model)
        self._patches: OrderedDict[Hashable, Patch] = OrderedDict()
        self._links: OrderedDict[Hashable, LinkedPatches | None] = OrderedDict()

    def transfer_impedances(
        self, loads: Sequence[Mapping[LoadFamily, float]], contact_impedance: Array | None = None
    ) -> Array:
        """Electrode potentials per electrode current at moments that follow each other closely.

        The first moment's are exact; the others' lack what is of third order in what has changed since, see
        :meth:`LinkedPatches.corrections <cbsr_qa.forward.linked_patches.LinkedPatches.corrections>`.

        Parameters
        ----------
        loads : strength of each load, the same loads at all moments.
        contact_impedance : (electrodes,) z in place of the model's at all these moments [Ω·mm].

        Returns
        -------
        (moments, electrodes, electrodes) float64 [V/A], for currents that sum to zero and differences of potentials.

        Raises
        ------
        NumericsError
            If an element is left without conductance, or a contact impedance is not a positive finite number.
        """
        before = self.model.transfer_impedance
        contact_change, own = self._local.contact_change(contact_impedance)
        if not loads[0] and contact_change is None:
            return np.repeat(before[None], len(loads), axis=0)
        link = self._link(tuple(loads[0]), contact_change is not None)
        if link is None:
            each = (_together(self.model, moment) for moment in loads)
            return np.array([self._local.transfer_impedance(*one, contact_impedance) for one in each])
        changed: Array = before + own - link.corrections(loads, contact_change)
        return changed

    def _link(self, families: tuple[LoadFamily, ...], contacts: bool) -> LinkedPatches | None:
        """What links some loads, or None where the local update has to do it."""
        key = (frozenset(families), contacts)
        if key not in self._links:
            _make_room(self._links, _MOST_LINKS)
            self._links[key] = self._linked(families, contacts)
        self._links.move_to_end(key)
        return self._links[key]

    def _linked(self, families: tuple[LoadFamily, ...], contacts: bool) -> LinkedPatches | None:
        elements = np.unique(np.concatenate([np.zeros(0, dtype=np.int64), *(family.elements for family in families)]))
        if contacts and not self._local.contacts_can_be_patches(elements):
            return None
        groups = _overlapping(families)
        sizes = [len(np.unique(np.concatenate([family.elements for family in group]))) for group in groups]
        if sum(size**3 for size in sizes) >= _MOST_WORK:
            return None
        patches = [self._patch(group) for group in groups]
        return LinkedPatches(self.model, self._inverse, patches, self._contacts if contacts else None)

    def _patch(self, group: tuple[LoadFamily, ...]) -> Patch:
        key = frozenset(group)
        if key not in self._patches:
            _make_room(self._patches, _MOST_PATCHES)
            self._patches[key] = Patch(self.model, self._inverse, group)
        self._patches.move_to_end(key)
        return self._patches[key]


def _make_room(kept: "OrderedDict[Hashable, Kept]", most: int) -> None:
    """Drop those unused for longest, until there are fewer and they take less memory than is allowed."""
    sizes = [one.nbytes if one is not None else 0 for one in kept.values()]
    used = sum(sizes)
    for size in sizes:
        if len(kept) < most and used < _MOST_BYTES:
            break
        kept.popitem(last=False)
        used -= size


def _overlapping(families: Sequence[LoadFamily]) -> list[tuple[LoadFamily, ...]]:
    """Groups of loads that share elements. Those that only share nodes, which then are on both rims, are apart."""
    groups: list[tuple[list[LoadFamily], set[int]]] = []
    for family in families:
        elements = set(family.elements.tolist())
        touching = [group for group in groups if group[1] & elements]
        groups = [group for group in groups if not group[1] & elements]
        members = [member for group in touching for member in group[0]]
        groups.append(([*members, family], elements.union(*(group[1] for group in touching))))
    return [tuple(members) for members, _ in groups]


def _together(model: ForwardModel, loads: Mapping[LoadFamily, float]) -> tuple[Indices, Array]:
    """Elements and changes of all loads, one behind the other."""
    none = np.zeros((0, len(model.elements.shapes.points), 2, 2))
    elements = [np.zeros(0, dtype=np.int64), *(family.elements for family in loads)]
    changes = [none, *(family.change(strength) for family, strength in loads.items())]
    return np.concatenate(elements), np.concatenate(changes)
