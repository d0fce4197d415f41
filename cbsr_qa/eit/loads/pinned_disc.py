"""Fields of a homogeneous disc with round pins, expanded about any point: no mesh, full precision.

A potential is the real part of an analytic function. A pin that carries a current is a logarithm at its centre plus
poles d_n (z − p)⁻ⁿ that hold its rim at one potential behind the contact impedance; the sheet's edge adds the image
of every source, f(z) + conj f(R²/z̄) (Milne-Thomson's circle theorem). Everything here is in units of the sheet's
radius and at unit sheet conductance. Complex coefficients are kept as real vectors, real parts before imaginary ones.
"""

from math import ceil, comb, log

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.numbers import Array
from cbsr_qa.domain.sensor.electrodes import ElectrodeKind, Electrodes
from cbsr_qa.eit.forward.closed_forms import project_to_ground
from cbsr_qa.eit.loads.round_load import Expansion

Complex = NDArray[np.complex128]

_CENTRAL = 1e-4  # of the radius: a pin closer to the centre is moved out to here
_PIN_ERROR = 1e-6  # bound of the effect of omitted poles, relative to a pin's own potential; usually far less


class PinnedDisc:
    """A homogeneous round sheet of unit conductance with equal round pins through it.

    Parameters
    ----------
    radius_mm : radius of the sheet.
    electrodes : pins anywhere inside it.
    contact_mm : contact impedance times sheet conductance [mm].

    Raises
    ------
    NumericsError
        If the electrodes are not pins, or not inside the sheet clear of each other.
    """

    def __init__(self, radius_mm: float, electrodes: Electrodes, contact_mm: float) -> None:
        if electrodes.kind is not ElectrodeKind.PIN:
            raise NumericsError("fields about a place are exact for pins only", remedy="use a mesh for arcs")
        self.radius_mm = radius_mm
        pins = electrodes.positions_mm() @ np.array([1, 1j]) / radius_mm
        # The image of a pin exactly at the centre would be infinitely far.
        self._pins: Complex = np.where(np.abs(pins) > _CENTRAL, pins, _CENTRAL + 0j)
        self._images = 1 / self._pins.conj()
        self._rim = electrodes.width_mm / 2 / radius_mm
        self._poles = self._pole_count()
        self._impedance = contact_mm / (electrodes.width_mm / 2)  # of a rim's harmonic 1, over the sheet's
        self._mirror = _image_poles(self._images, self._poles)
        self._scatter, self._driven = self._solve_pins()

    def _pole_count(self) -> int:
        distance = np.abs(self._pins[:, None] - self._pins)
        np.fill_diagonal(distance, np.inf)
        ratio = self._rim / min(float(np.abs(self._images - self._pins).min()), float(distance.min()))
        if not (0 < ratio < 0.5 and (np.abs(self._pins) + self._rim < 1).all()):
            raise NumericsError(
                f"pins of {2 * self._rim * self.radius_mm:g} mm do not lie inside the sheet, clear of each other"
            )
        return max(1, ceil(log(_PIN_ERROR) / (2 * log(ratio)) - 1))

    @property
    def extent_mm(self) -> tuple[float, float, float, float]:
        return -self.radius_mm, self.radius_mm, -self.radius_mm, self.radius_mm

    def clearance_mm(self, place_mm: Array) -> Array:
        """Radius of the largest disc about each place (n, 2) that touches neither edge nor pin: (n,) [mm]."""
        centre = self._centres(place_mm)
        to_pin = np.abs(centre[:, None] - self._pins).min(axis=1) - self._rim
        clear: Array = self.radius_mm * np.minimum(1 - np.abs(centre), to_pin)
        return clear

    def fields(self, place_mm: Array, reach_mm: Array, orders: int) -> Array:
        """Fields of unit currents about places, as in :class:`~cbsr_qa.eit.loads.round_load.Expansion`."""
        return self._expand_about(place_mm, reach_mm, orders)[0]

    def expansion(self, place_mm: Array, reach_mm: Array, orders: int) -> Expansion:
        """Expand about places.

        Parameters
        ----------
        place_mm : (n, 2).
        reach_mm : (n,) unit of distances from each place; positive.
        orders : M; the truncation error falls as (reach over the distance of the nearest pin)^(2M).
        """
        fields, poles, scale = self._expand_about(place_mm, reach_mm, orders)
        weights = np.tile(np.arange(1, orders + 1), 2)
        response = poles @ self._scatter @ (poles.transpose(0, 2, 1) * weights)
        response += _edge_reflection(self._centres(place_mm), orders) * scale * scale.transpose(0, 2, 1)
        return Expansion(orders, fields, response)

    def _expand_about(self, place_mm: Array, reach_mm: Array, orders: int) -> tuple[Array, Array, Array]:
        """Fields of currents and of the pins' poles about places, and their scales."""
        centre, reach = self._centres(place_mm), np.asarray(reach_mm) / self.radius_mm
        scale = np.concatenate([_powers(reach, orders)] * 2, axis=-1)[..., None]
        pin_powers = _powers(1 / (self._pins - centre[:, None]), orders + self._poles)
        image_powers = _powers(1 / (self._images - centre[:, None]), orders + self._poles)
        poles = self._fields_of_poles(pin_powers, image_powers, orders) * scale
        logs = (pin_powers + image_powers)[..., :orders].transpose(0, 2, 1) / (
            2 * np.pi * np.arange(1, orders + 1)[:, None]
        )
        return _stack_parts(logs) * scale + poles @ self._driven, poles, scale

    def transfer_impedance(self) -> Array:
        """Electrode potentials per electrode current, (electrodes, electrodes) [Ω], with ΣI = ΣU = 0."""
        separation = self._pins[:, None] - self._pins
        np.fill_diagonal(separation, 1)
        impedance = -np.log(np.abs(separation) * np.abs(1 - self._pins[:, None] * self._pins.conj())) / (2 * np.pi)
        impedance += np.eye(len(self._pins)) * (self._impedance - log(self._rim)) / (2 * np.pi)
        np.fill_diagonal(separation, np.inf)
        direct = _powers(1 / separation, self._poles)
        image = _powers(self._pins[:, None] / (1 - self._pins[:, None] * self._pins.conj()), self._poles)
        direct, image = (values.reshape(len(values), -1) for values in (direct, image))
        from_poles = np.concatenate([(direct + image).real, (image - direct).imag], axis=1)
        return project_to_ground(impedance + from_poles @ self._driven)

    def _centres(self, place_mm: Array) -> Complex:
        place = np.asarray(place_mm, dtype=np.float64)
        centre: Complex = place @ np.array([1, 1j]) / self.radius_mm
        return centre

    def _fields_of_poles(self, near: Complex, far: Complex, orders: int) -> Array:
        """Coefficients (n, 2·orders, 2·pins·poles) about places of the fields of every pin's poles and their images.

        ``near``, ``far`` : (n, pins, powers) of one over the way to each pin, and to its image.
        """
        powers = np.arange(orders)[:, None] + np.arange(1, self._poles + 1)  # power m + n of pole n, from 0
        factor = np.array(
            [[comb(n + m - 1, m) * (-1) ** n for n in range(1, self._poles + 1)] for m in range(1, orders + 1)]
        )
        pole_fields = (near[..., powers] * factor).transpose(0, 2, 1, 3)  # (n, orders, pins, poles)
        image_fields = ((far[..., powers] * factor) @ self._mirror).transpose(0, 2, 1, 3)
        shape = (*pole_fields.shape[:2], -1)
        pole_fields, image_fields = pole_fields.reshape(shape), image_fields.reshape(shape)
        total, difference = pole_fields + image_fields, pole_fields - image_fields
        upper = np.concatenate([total.real, -difference.imag], axis=2)
        lower = np.concatenate([total.imag, difference.real], axis=2)
        return np.concatenate([upper, lower], axis=1)

    def _solve_pins(self) -> tuple[Array, Array]:
        """Poles of the pins per pole of the field around them, (2K, 2K), and per electrode current, (2K, pins).

        A pin in a field Σ B_n wⁿ has poles d_n = −b²ⁿ (1 − ζn)/(1 + ζn) conj(B_n), ζ = zγ/b: its rim's potential
        behind the contact is one.
        """
        count, order = len(self._pins), np.arange(1, self._poles + 1)
        strength = -(self._rim ** (2 * order)) * (1 - self._impedance * order) / (1 + self._impedance * order)
        pin_coupling, from_currents = self._pins_on_pins()
        mirror = np.concatenate([np.tile(strength, count), -np.tile(strength, count)])[:, None]  # conjugates
        scatter = np.linalg.solve(np.eye(len(mirror)) - mirror * pin_coupling, np.diag(mirror[:, 0]))
        signs = np.concatenate([np.tile(1 / order, count), -np.tile(1 / order, count)])
        return scatter * signs, scatter @ from_currents

    def _pins_on_pins(self) -> tuple[Array, Array]:
        """Fields about each pin of the others' poles and of all images, (2K, 2K), and of currents, (2K, pins)."""
        separation = self._pins - self._pins[:, None]  # (about, of)
        np.fill_diagonal(separation, np.inf)  # a pin is not in its own direct field
        pin_powers = _powers(1 / separation, 2 * self._poles)
        image_powers = _powers(1 / (self._images - self._pins[:, None]), 2 * self._poles)
        poles = self._fields_of_poles(pin_powers, image_powers, self._poles)
        logs = (pin_powers + image_powers)[..., : self._poles].transpose(0, 2, 1)
        currents = _stack_parts(logs / (2 * np.pi * np.arange(1, self._poles + 1)[:, None]))
        return tuple(  # type: ignore[return-value]
            values.reshape(len(values), 2, self._poles, -1).swapaxes(0, 1).reshape(-1, values.shape[-1])
            for values in (poles, currents)
        )


def _powers(base: NDArray[np.inexact], count: int) -> NDArray:  # type: ignore[type-arg]
    """base¹ … base^count along a new last axis."""
    result = np.empty((*base.shape, count), dtype=base.dtype)
    result[..., 0] = base
    for k in range(1, count):
        np.multiply(result[..., k - 1], base, out=result[..., k])
    return result


def _stack_parts(values: Complex) -> Array:
    """Real parts above imaginary parts along the second axis."""
    return np.concatenate([values.real, values.imag], axis=1)


def _image_poles(images: Complex, count: int) -> Complex:
    """Image of a pole's conj(d_n) at a pin: (pins, j, n) coefficients of (z − image)⁻ʲ.

    The image of (z − p)⁻ⁿ is (z/(1 − p̄z))ⁿ = (−p*)ⁿ Σ_j C(n, j) p*ʲ (z − p*)⁻ʲ; the constant j = 0 drives nothing.
    """
    poles = np.zeros((len(images), count, count), dtype=np.complex128)
    for n in range(1, count + 1):
        for j in range(1, n + 1):
            poles[:, j - 1, n - 1] = (-images) ** n * comb(n, j) * images**j
    return poles


def _edge_reflection(centre: Complex, orders: int) -> Array:
    """Reflection of the edge at a place: its part of an expansion's response, (n, 2·orders, 2·orders).

    The image of (z − c)⁻ⁿ is (z/(1 − c̄z))ⁿ; with w = z − c and β = 1 − |c|² it is (c/β + β⁻² w/(1 − w c̄/β))ⁿ.
    """
    count = np.arange(orders + 1)
    choose = np.array([[comb(n, j) for j in count] for n in count], dtype=np.float64)
    gap = 1 - np.abs(centre) ** 2
    ones = np.ones_like(centre)[:, None]
    base = np.concatenate([ones, _powers(centre / gap, orders)], axis=1)
    lag = count[1:, None] - count[1:]  # (n or m, j)
    lower = np.where(lag >= 0, base[:, np.maximum(lag, 0)], 0)
    rising = choose[1:, 1:] * lower
    falling = choose[:-1, :-1] * lower.conj()
    size = _powers(gap**-2, orders)
    transfer = (falling * size[:, None]) @ rising.transpose(0, 2, 1)  # (m, n)
    upper = np.concatenate([transfer.real, -transfer.imag], axis=2)
    return np.concatenate([upper, np.concatenate([transfer.imag, transfer.real], axis=2)], axis=1)
