"""Exact voltages after local conductance changes, without a new factorisation.

Changed elements form patches. A node whose elements all belong to one patch, and which lies on no electrode, is
condensed away. With E the discrete harmonic extension from a patch's rim to its inside (E of the new conductance, E₀
of the old), the patch seen from its rim changes by

    ΔΛ = Eᵀ ΔK E₀

which is the difference of the two Schur complements without cancellation. With F the fields of the electrodes on all
rims and W = K₀⁻¹ between rim nodes the transfer impedance changes by −Fᵀ (I + ΔΛ W)⁻¹ ΔΛ F (Woodbury; Hager 1989). F,
W and E₀ do not depend on the change. Fields between rims are smooth: to rounding they lie in a space of some fifteen
dimensions, and one system in these couples all patches.

A contact is such a patch too, all rim: only the matrix under its electrode changes, by Δ(1/z) ∫ (u − ū)(v − v̄), and
the electrode's own potential by Δz/|E|. If so much changes that this would take longer, the whole sheet is factorised
again.
"""

from collections import OrderedDict
from typing import Final

import numpy as np

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.numbers import Array, Indices
from cbsr_qa.eit.forward.model import ForwardModel
from cbsr_qa.eit.forward.value_range import check_values
from cbsr_qa.eit.loads.patches import Patches, check_change, dense_work
from cbsr_qa.eit.loads.rims import InverseEntries

#: Memory for caches of sets of elements; nine heads on a mesh of 2.5 mm take 2 MB.
KEPT_BYTES: Final = 64 << 20
_LEAST_CONTACT: Final = 1e-3  # z γ/|E|: readings are then accurate to some 1e-10
_MOST_WORK: Final = 2e8  # cubes of the patches' nodes, about as long as factorising 8000 elements


class LocalUpdate:
    """Voltages of a model whose conductance changes on a few elements at a time."""

    def __init__(self, model: ForwardModel) -> None:
        self.model = model
        self._unchanged = model.voltages()
        self._inverse = InverseEntries(model)
        self._touched = np.concatenate(model.prepared.contacts.nodes)
        self._kept: OrderedDict[bytes, Patches | None] = OrderedDict()

    @property
    def nbytes(self) -> int:
        """Memory kept between calls [bytes]."""
        return self._inverse.nbytes + self._cache_bytes()

    def voltages(self, elements: Indices, conductance_change: Array, contact_impedance: Array | None = None) -> Array:
        """Readings (drives, measures) [V/A] after conductances of some elements, or contacts, have changed.

        Parameters
        ----------
        elements : (k,) int64; changes of an element named twice add up.
        conductance_change : (k,) [S] relative to the model's conductance; or (k, q, 2, 2) as in :meth:`Cover.change
            <cbsr_qa.eit.forward.coverage.Cover.change>`.
        contact_impedance : (electrodes,) z in place of the model's [Ω·mm].

        Raises
        ------
        NumericsError
            If an element is not in the mesh, or a new conductance or contact impedance is not positive and finite.
        """
        changed = self._solve_change(elements, conductance_change, contact_impedance)
        if isinstance(changed, ForwardModel):
            return changed.voltages()
        lost, own_change = changed  # separately: voltages of driven contacts cost the other readings no digits
        return self._unchanged - self.model.readings(lost) + self.model.readings(own_change)

    def transfer_impedance(
        self, elements: Indices, conductance_change: Array, contact_impedance: Array | None = None
    ) -> Array:
        """Transfer impedance (electrodes, electrodes) [V/A] after the same changes, for currents that sum to zero."""
        change = self._solve_change(elements, conductance_change, contact_impedance)
        if isinstance(change, ForwardModel):
            return change.transfer_impedance
        lost, own_change = change
        return self.model.transfer_impedance - lost + own_change

    def _solve_change(
        self, elements: Indices, change: Array, contact_impedance: Array | None
    ) -> ForwardModel | tuple[Array, Array]:
        """Change of the transfer impedance by the sheet and by contacts; or the sheet factorised again."""
        elements, change = self._check_change(elements, change)
        contact_change, own_change = self.contact_change(contact_impedance)
        if not elements.size and contact_change is None:
            return np.zeros_like(self.model.transfer_impedance), np.zeros_like(self.model.transfer_impedance)
        patches = self._patches(elements, contact_change is not None)
        if patches is None:
            return self.model.with_change_on(elements, change, contact_impedance)
        return patches.correction(change, contact_change), own_change

    def contact_change(self, impedance: Array | None) -> tuple[Array | None, Array]:
        """Change of 1/z [S/mm], or None if unchanged, and change of each electrode's own potential."""
        old = self.model.contact_impedance
        if impedance is None or np.array_equal(impedance, old):
            return None, np.zeros((len(old), len(old)))
        impedance = check_values("contact impedance", np.asarray(impedance, dtype=np.float64), old.shape)
        lengths = self.model.prepared.contacts.lengths_mm
        return (old - impedance) / (old * impedance), np.diag((impedance - old) / lengths)

    def _check_change(self, elements: Indices, change: Array) -> tuple[Indices, Array]:
        elements, change = np.asarray(elements, dtype=np.int64), np.asarray(change, dtype=np.float64)
        model = self.model
        shape = elements.shape if change.ndim == 1 else (*elements.shape, len(model.elements.shapes.points), 2, 2)
        if elements.ndim != 1 or change.shape != shape:
            raise NumericsError(f"conductance changes {change.shape} do not match elements {elements.shape}")
        model.check_elements(elements)
        unique, total = elements, change
        if not (elements[1:] > elements[:-1]).all():
            unique, place = np.unique(elements, return_inverse=True)
            total = np.zeros((len(unique), *change.shape[1:]))
            np.add.at(total, place, change)
        check_change(model, unique, total)
        return unique.astype(np.int64), total

    def _patches(self, elements: Indices, contacts: bool) -> Patches | None:
        """Patches of some elements, or None if factorising the whole sheet again is cheaper."""
        key = elements.tobytes() + b"contacts" * contacts
        if key not in self._kept:
            short = dense_work(self.model, elements) < _MOST_WORK
            short = short and (not contacts or self.contacts_can_be_patches(elements))
            self._kept[key] = Patches(self.model, elements, self._inverse, contacts=contacts) if short else None
            while len(self._kept) > 1 and self._cache_bytes() > KEPT_BYTES:
                self._kept.popitem(last=False)
        self._kept.move_to_end(key)
        return self._kept[key]

    def contacts_can_be_patches(self, elements: Indices) -> bool:
        """Whether no element touches an electrode, and no contact is so good that its own part is only rounding."""
        if np.isin(self.model.elements.cells[elements], self._touched).any():
            return False
        conductance = self.model.conductance
        mean = float(conductance.mean() if conductance.ndim == 1 else conductance[..., (0, 1), (0, 1)].mean())
        lengths = self.model.prepared.contacts.lengths_mm
        return bool((self.model.contact_impedance * mean >= _LEAST_CONTACT * lengths).all())

    def _cache_bytes(self) -> int:
        return sum(patches.nbytes for patches in self._kept.values() if patches is not None)
