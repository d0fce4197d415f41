"""Voltages of a sheet under many loads of fixed shape and varying strength.

Like :class:`~cbsr_qa.eit.loads.local.LocalUpdate`, with which it agrees to eight digits, but for sequences of frames:
responses are tabulated over strength (:mod:`cbsr_qa.eit.loads.family`), contacts are eliminated once for many
strengths, and fields at a rim below a part in 10⁸ are left out.
"""

from collections import OrderedDict
from collections.abc import Hashable, Mapping, Sequence
from typing import Final, TypeVar

import numpy as np

from cbsr_qa.domain.numbers import Array, Indices
from cbsr_qa.eit.forward.model import ForwardModel
from cbsr_qa.eit.loads.family import TERMS, LoadFamily, Patch, polynomials
from cbsr_qa.eit.loads.local import LocalUpdate
from cbsr_qa.eit.loads.patches import ContactStack
from cbsr_qa.eit.loads.rims import InverseEntries, couple

# Size of omitted fields at a rim, over the largest. The response to a weak field is weak at other rims too: readings
# contain its square.
_NEGLIGIBLE: Final = 1e-8
_NEGLIGIBLE_CONTACT: Final = 3e-6
_ROUNDING: Final = 1e-14  # a single load is only in the electrodes' few fields


class LinkedPatches:
    """Change of a sheet's impedance by loads on patches that share no element, and by changed contacts.

    With B = K₀⁻¹ between the patches and F the electrodes' fields there, both in the few fields that occur, and A the
    patches' responses, the transfer impedance loses Fᵀ (I + A B)⁻¹ A F. Contacts come first: with G their own
    decrease, B − B G B and F − B G F serve all strengths of the loads until the contacts change again.

    Parameters
    ----------
    inverse : gives K₀⁻¹ between nodes of the rims.
    patches : patches of the loads; shared nodes are on both rims.
    contacts : True if contacts change too; no load may then touch one.
    """

    def __init__(
        self, model: ForwardModel, inverse: InverseEntries, patches: Sequence[Patch], contacts: ContactStack | None
    ) -> None:
        self._patches = tuple(patches)
        self._contacts = contacts
        rims = [patch.rim for patch in patches] + ([] if contacts is None else list(contacts.rims))
        count = len(patches)
        least = [_NEGLIGIBLE if k < count else _NEGLIGIBLE_CONTACT for k in range(len(rims))]
        least = least if len(rims) > 1 else [_ROUNDING]
        coupling = couple(model, inverse, rims, least, (count, len(rims) - count))
        self._bases, self._contact_bases = coupling.bases[:count], coupling.bases[count:]
        self._contact_own = np.stack(coupling.own[count:]) if contacts is not None else np.zeros((0, 0, 0))
        self._between, self._fields = coupling.between, coupling.fields
        self._loads = sum(basis.shape[1] for basis in self._bases)
        self._series, self._reach = self._project_responses()
        self._eliminated: tuple[bytes, tuple[Array, Array, Array]] | None = None

    @property
    def nbytes(self) -> int:
        """Memory it takes beside its patches."""
        eliminated = self._eliminated[1] if self._eliminated else ()
        arrays = [*self._bases, *self._contact_bases, self._between, self._fields, self._series, self._contact_own]
        return sum(array.nbytes for array in [*arrays, *eliminated])

    def corrections(self, loads: Sequence[Mapping[LoadFamily, float]], contact_change: Array | None) -> Array:
        """Decrease of the transfer impedance, at several moments: (moments, electrodes, electrodes) [V/A].

        The first moment's is exact. With φ = (I + B A)⁻¹ F the fields at the patches then and D the later change of
        their responses, the others' are the first's and φᵀ (D − D (B − B A B) D) φ, right to second order.

        Parameters
        ----------
        loads : strength of every load of the patches, at each moment.
        contact_change : (electrodes,) change of 1/z [S/mm], if contacts change too, the same at all moments.
        """
        coupling, fields, contact_correction = self._split_off_contacts(contact_change)
        if not self._patches:
            return np.repeat(contact_correction[None], len(loads), axis=0)
        answers = np.array([self._answers(moment) for moment in loads])
        system = _times(answers[0], coupling)
        np.einsum("ii->i", system)[:] += 1
        scattered = np.linalg.solve(system, _times(answers[0], fields))
        incident = fields - coupling @ scattered
        corrections = [contact_correction + fields.T @ scattered]
        for answer_change in answers[1:] - answers[0]:
            added_scattering = _times(answer_change, incident)
            coupled_scattering = coupling @ added_scattering
            corrections.append(
                corrections[0]
                + incident.T @ added_scattering
                - added_scattering.T @ coupled_scattering
                + coupled_scattering.T @ _times(answers[0], coupled_scattering)
            )
        return np.array(corrections)

    def _answers(self, loads: Mapping[LoadFamily, float]) -> Array:
        """Response of each patch to the fields it sees: (patches, rank, rank)."""
        single_strengths = np.array([loads[patch.families[0]] if patch.series else np.inf for patch in self._patches])
        is_within_reach = np.abs(single_strengths) <= self._reach
        strengths = np.where(is_within_reach, single_strengths, 0.0)
        terms = polynomials(strengths / np.where(self._reach > 0, self._reach, 1.0)) * strengths[:, None]
        rank = self._bases[0].shape[1]
        answers: Array = (terms[:, None, :] @ self._series).reshape(-1, rank, rank)
        for number in np.flatnonzero(~is_within_reach):
            patch, basis = self._patches[number], self._bases[number]
            answers[number] = basis.T @ patch.answer([loads[family] for family in patch.families]) @ basis
        return answers

    def _project_responses(self) -> tuple[Array, Array]:
        """Series of the responses (patches, terms, rank · rank) in the fields that occur, and their reach."""
        rank = self._bases[0].shape[1] if self._bases else 0
        series = np.zeros((len(self._patches), TERMS, rank * rank))
        reach = np.zeros(len(self._patches))
        for number, (patch, basis) in enumerate(zip(self._patches, self._bases, strict=True)):
            if patch.series is not None:
                projected = basis.T @ patch.series.coefficients @ basis
                series[number] = projected.reshape(TERMS, -1)
                reach[number] = patch.series.reach
        return series, reach

    def _split_off_contacts(self, change: Array | None) -> tuple[Array, Array, Array]:
        """B and F between loads with changed contacts, and the contacts' own contribution."""
        loads = slice(0, self._loads)
        if change is None or self._contacts is None:
            return self._between[loads, loads], self._fields[loads], np.zeros((self._fields.shape[1],) * 2)
        key = change.tobytes()
        if self._eliminated is None or self._eliminated[0] != key:
            self._eliminated = key, self._eliminate(self._contacts.rim_changes(change))
        return self._eliminated[1]

    def _eliminate(self, seen: Array) -> tuple[Array, Array, Array]:
        loads, contacts = slice(0, self._loads), slice(self._loads, None)
        capacitance = np.eye(seen.shape[1]) + seen @ self._contact_own
        met = np.stack(self._contact_bases)
        answers = met.swapaxes(1, 2) @ np.linalg.solve(capacitance, seen @ met)
        rows = np.hstack([self._between[contacts], self._fields[contacts]])
        answered = _times(answers, rows)
        system = answered[:, contacts.start : len(self._between)]
        solved = np.linalg.solve(np.eye(len(system)) + system, answered)  # G times all rows
        into = solved[:, loads], solved[:, len(self._between) :]
        towards = self._between[loads, contacts]
        return (
            self._between[loads, loads] - towards @ into[0],
            self._fields[loads] - towards @ into[1],
            self._fields[contacts].T @ into[1],
        )


def _times(blocks: Array, rows: Array) -> Array:
    """Blocks (g, r, r) on a diagonal, times rows (g · r, n)."""
    return (blocks @ rows.reshape(len(blocks), blocks.shape[2], -1)).reshape(rows.shape)


Kept = TypeVar("Kept", Patch, LinkedPatches | None)

_MOST_PATCHES: Final = 192  # some 0.3 MB each; tens of times that for many overlapping loads
_MOST_LINKS: Final = 24
_MOST_BYTES: Final = 96 << 20  # of either
_MOST_WORK: Final = 2e7  # cubes of the patches' elements, which have some two nodes each of their own


class LoadedSheet:
    """Transfer impedances of a model under loads."""

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

        The first moment's are exact, the others' accurate to second order in later changes.

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
        unloaded = self.model.transfer_impedance
        contact_change, own_change = self._local.contact_change(contact_impedance)
        if not loads[0] and contact_change is None:
            return np.repeat(unloaded[None], len(loads), axis=0)
        link = self._link(tuple(loads[0]), contact_change is not None)
        if link is None:
            changes = (_multi_load(self.model, moment) for moment in loads)
            return np.array([self._local.transfer_impedance(*change, contact_impedance) for change in changes])
        return unloaded + own_change - link.corrections(loads, contact_change)

    def _link(self, families: tuple[LoadFamily, ...], contacts: bool) -> LinkedPatches | None:
        """Coupling of some loads, or None if the local update must be used."""
        key = (frozenset(families), contacts)
        if key not in self._links:
            _make_room(self._links, _MOST_LINKS)
            self._links[key] = self._link_patches(families, contacts)
        self._links.move_to_end(key)
        return self._links[key]

    def _link_patches(self, families: tuple[LoadFamily, ...], contacts: bool) -> LinkedPatches | None:
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
    """Discard those unused for longest, until number and memory are within the limits."""
    sizes = [item.nbytes if item is not None else 0 for item in kept.values()]
    used_bytes = sum(sizes)
    for size in sizes:
        if len(kept) < most and used_bytes < _MOST_BYTES:
            break
        kept.popitem(last=False)
        used_bytes -= size


def _overlapping(families: Sequence[LoadFamily]) -> list[tuple[LoadFamily, ...]]:
    """Groups of loads that share elements; loads that only share nodes, which are then on both rims, are separate."""
    groups: list[tuple[list[LoadFamily], set[int]]] = []
    for family in families:
        elements = set(family.elements.tolist())
        touching = [group for group in groups if group[1] & elements]
        groups = [group for group in groups if not group[1] & elements]
        members = [member for group in touching for member in group[0]]
        groups.append(([*members, family], elements.union(*(group[1] for group in touching))))
    return [tuple(members) for members, _ in groups]


def _multi_load(model: ForwardModel, loads: Mapping[LoadFamily, float]) -> tuple[Indices, Array]:
    """Elements and changes of all loads, concatenated."""
    none = np.zeros((0, len(model.elements.shapes.points), 2, 2))
    elements = [np.zeros(0, dtype=np.int64), *(family.elements for family in loads)]
    changes = [none, *(family.change(strength) for family, strength in loads.items())]
    return np.concatenate(elements), np.concatenate(changes)
