"""Bodies other than sheets: a cylindrical tank with electrodes at mid-height, and a strip with two pins.

In a cylinder of radius 1 and depth H the potential is a sum over modes cos(κz), κ = 2πk/H, each of which solves
∇²u = κ²u in the plane: Bessel functions I_m(κρ) cos(mθ) instead of ρᵐ cos(mθ). H → 0 is the sheet.

On a strip, the current between the pins passes their contacts, the strip beside the head and the strip under it, in
series; only the last changes under load.
"""

from functools import cached_property
from typing import TYPE_CHECKING, Final

import numpy as np
from scipy.special import ive

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.numbers import Array, Indices
from cbsr_qa.domain.readings.loads import Indenter
from cbsr_qa.domain.sensor.patterns import DrivePattern
from cbsr_qa.domain.sensor.sensor_type import SensorType
from cbsr_qa.eit.forward.coverage import cover
from cbsr_qa.eit.forward.model import ForwardModel
from cbsr_qa.eit.loads.local import LocalUpdate
from cbsr_qa.eit.mesh.sheet import sheet_mesh

if TYPE_CHECKING:
    from scipy.interpolate import CubicSpline

_SIZE: Final = 0.1  # edge length far from the pins, of the strip's radius: changes of readings are accurate to 5e-4
_CHANGES: Final = np.expm1(np.linspace(-np.log(20.0), np.log(20.0), 41))  # tabulated range of conductance changes


def check_strip(sensor_type: SensorType) -> None:
    """Refuse a sensor type that is not a strip of two pins; NumericsError gives the requirements."""
    pattern = sensor_type.pattern
    if sensor_type.electrodes.count != 2 or pattern.drive[0] != pattern.measure[0]:
        raise NumericsError(
            f"sensor type {sensor_type.name!r} is not a strip: a material needs two pins, which carry"
            " the current and are measured themselves",
            remedy="use a sensor type of two electrodes, such as strip-40x20mm",
        )


class StripModel:
    """The resistance of a strip while the conductance under the head changes.

    Parameters
    ----------
    sensor_type : sensor type with two electrodes, whose first drive pair is also its first measure pair.
    indenter : the head, with its axis over ``place_mm``.
    contact_length_mm : contact impedance of a pin over the strip's sheet resistance.

    Raises
    ------
    NumericsError
        If the sensor type is not a strip, or the head does not touch it.
    """

    def __init__(
        self,
        sensor_type: SensorType,
        indenter: Indenter,
        contact_length_mm: float,
        *,
        place_mm: tuple[float, float] = (0.0, 0.0),
    ) -> None:
        check_strip(sensor_type)
        pattern = sensor_type.pattern
        mesh = sheet_mesh(sensor_type, size_mm=_SIZE * sensor_type.radius_mm, order=2)
        contact = np.full(2, float(contact_length_mm))
        model = ForwardModel(mesh, pattern, np.ones(len(mesh.elements)), contact, order=2)
        covered = cover(model.elements, indenter.footprint_at(*place_mm))
        if not covered.elements.size:
            raise NumericsError(f"the head at ({place_mm[0]:zg}, {place_mm[1]:zg}) mm does not touch the strip")
        update = LocalUpdate(model)
        resistance = [
            update.voltages(covered.elements, covered.change(model.conductance, float(change)))[0, 0]
            for change in _CHANGES
        ]
        #: share of the head on the strip
        self.pressed_mm2 = float(covered.share @ mesh.areas_mm2[covered.elements])
        #: resistance between the pins over the sheet resistance, unloaded
        self.squares = float(model.voltages()[0, 0])
        #: part of ``squares`` in the contacts
        self.contact_squares = float((model.contact_jacobian()[0, 0] * contact).sum())
        from scipy.interpolate import CubicSpline  # no sheet needs it

        # In logarithms both relations are nearly straight: a spline through these points is accurate to 1e-6 of a
        # change.
        local, apparent = np.log1p(_CHANGES), np.log(self.squares / np.array(resistance))
        self._apparent, self._local = CubicSpline(local, apparent), CubicSpline(apparent, local)
        self._range = (float(np.expm1(apparent[0])), float(np.expm1(apparent[-1])))

    @property
    def share(self) -> float:
        """Apparent over local change, of small changes: the head's share of the reading."""
        return float(self._apparent(0.0, 1))

    def apparent(self, local: Array) -> Array:
        """Relative change of the conductance between the pins, from relative changes under the head."""
        return np.asarray(np.expm1(self._apparent(np.log1p(local))), dtype=np.float64)

    def local(self, apparent: Array) -> Array:
        """Relative change of the conductance under the head, from relative changes between the pins.

        NumericsError if a change exceeds what the strip under the head can cause.
        """
        lowest, highest = self._range
        if apparent.size and not lowest <= float(apparent.min()) <= float(apparent.max()) <= highest:
            raise NumericsError(
                f"the conductance between the pins changed by {apparent.min():.3g} to {apparent.max():.3g};"
                f" the material under the head can change it by only {lowest:.3g} to {highest:.3g}",
                remedy="check for a loose pin: its contact has changed, not the material",
            )
        return np.asarray(np.expm1(self._local(np.log1p(apparent))), dtype=np.float64)


_ORDERS: Final = 160  # of angle: electrodes of a tenth of the radius damp higher orders
_DAMPED: Final = 30.0  # modes are summed up to κ of this, over an electrode's height
_UNIFORM: Final = 12  # orders from which Debye's expansion gives I_m to ten digits
_RADII: Final = 241  # at which the radial functions are tabulated


class DeepTank:
    """A tank of unit radius and unit conductivity.

    Parameters
    ----------
    depth : H, in units of the radius.
    angles_rad : (electrodes,), electrodes at the wall and at mid-height.
    electrode : width and height of an electrode, in units of the radius.
    """

    def __init__(self, depth: float, angles_rad: Array, pattern: DrivePattern, *, electrode: float = 0.1) -> None:
        self._angles, self._pattern = angles_rad, pattern
        order = np.arange(_ORDERS + 1)
        # Fourier series of a strip, and of unit current at an angle; order 0 adds a constant.
        self._weight = np.where(order > 0, np.sinc(order * electrode / (2 * np.pi)) / np.pi, 0.0)
        count = int(np.ceil(_DAMPED / electrode * depth / (2 * np.pi) / 5)) + 1
        self._modes = 2 * np.pi * np.arange(count) / depth
        share = np.sinc(self._modes * electrode / (2 * np.pi))
        self._share = np.where(self._modes > 0, 2 * share, 1.0) / depth
        self._seen = share

    def readings(self) -> Array:
        """Readings per unit current and resistivity, (drives, measures)."""
        order = np.arange(_ORDERS + 1)
        radial = np.zeros(_ORDERS + 1)
        for mode, share, electrode_gain in zip(self._modes, self._share, self._seen, strict=True):
            radial += share * electrode_gain * _radial(mode, np.ones(1))[0]
        angles_apart = self._angles[:, None] - self._angles
        coefficients = self._weight**2 * np.pi * radial
        impedance = np.einsum("m,ijm->ij", coefficients, np.cos(order * angles_apart[..., None]))
        drive, measure = self._pattern.drive_currents(), self._pattern.measure_matrix()
        readings: Array = drive.T @ impedance @ measure
        return readings

    def changes(self, places: Array, radius: float, *, conducts: bool) -> Array:
        """Changes of the readings for balls in the electrodes' plane, linear in their volume.

        Dipole and quadrupole at the ball's centre; no higher orders.

        Parameters
        ----------
        places : (p, 2), in units of the tank's radius; inside 0.95.
        radius : radius of the balls.
        conducts : True for perfect conductors, False for insulators.

        Returns
        -------
        (p, drives, measures), per unit of volume.
        """
        first_derivatives, second_derivatives = self._derivatives(places)
        drive, measure = self._pattern.drive_currents(), self._pattern.measure_matrix()
        dipole, quadrupole = (3.0, 5 / 2) if conducts else (-3 / 2, -5 / 3)
        gradient = (
            np.einsum("pea,ed->pda", first_derivatives, drive),
            np.einsum("pea,em->pma", first_derivatives, measure),
        )
        bend = (
            np.einsum("pea,ed->pda", second_derivatives, drive),
            np.einsum("pea,em->pma", second_derivatives, measure),
        )
        change: Array = dipole * np.einsum("pda,pma->pdm", *gradient)
        change += quadrupole * radius**2 / 5 * np.einsum("pda,pma->pdm", *bend)
        return -change

    def _derivatives(self, places: Array) -> tuple[Array, Array]:
        """Gradient (p, electrodes, 2) and second derivatives (p, electrodes, 4) of each electrode's potential.

        The second derivatives, along ρ and θ, across (√2 ∂ρθ) and along z, are weighted to have the matrices' scalar
        product.
        """
        radius = np.maximum(np.hypot(places[:, 0], places[:, 1]), 1e-3)
        angle = np.arctan2(places[:, 1], places[:, 0])
        order = np.arange(_ORDERS + 1)
        value, slope, bend = (self._radials.derivative(k)(radius) if k else self._radials(radius) for k in range(3))
        cosine, sine = self._evaluate_waves(angle, np.cos), self._evaluate_waves(angle, np.sin)

        def series(coefficients: Array, waves: tuple[Array, Array], turned: bool) -> Array:
            """Sum over orders at each place and electrode of coefficient × cos or sin of m(φ − θ)."""
            (at_cos, at_sin), (el_cos, el_sin) = waves, self._at_electrodes
            if turned:
                return (coefficients * at_sin) @ el_cos.T - (coefficients * at_cos) @ el_sin.T
            return (coefficients * at_cos) @ el_cos.T + (coefficients * at_sin) @ el_sin.T

        waves, rho = (cosine, sine), radius[:, None]
        radial, tangential = series(slope, waves, False), -series(order * value, waves, True) / rho
        rr = series(bend, waves, False)
        tt = radial / rho - series(order**2 * value, waves, False) / rho**2
        rt = -series(order * slope, waves, True) / rho - tangential / rho
        first, second = np.stack([radial, tangential], axis=2), np.stack([rr, tt, np.sqrt(2) * rt, -rr - tt], axis=2)
        return first, second

    @staticmethod
    def _evaluate_waves(angle: Array, wave: np.ufunc) -> Array:
        waves: Array = wave(angle[:, None] * np.arange(_ORDERS + 1))
        return waves

    @cached_property
    def _at_electrodes(self) -> tuple[Array, Array]:
        return self._evaluate_waves(self._angles, np.cos), self._evaluate_waves(self._angles, np.sin)

    @cached_property
    def _radials(self) -> "CubicSpline":
        """Radial function of every order in the electrodes' plane, tabulated."""
        from scipy.interpolate import CubicSpline

        radii = np.linspace(1e-3, 0.97, _RADII)
        table = np.zeros((_RADII, _ORDERS + 1))
        for mode, share in zip(self._modes, self._share, strict=True):
            table += share * _radial(mode, radii)
        return CubicSpline(radii, self._weight * table)


def _radial(mode: float, radii: Array) -> Array:
    """I_m(κρ) / (κ I_m′(κ)) for all orders, (radii, orders); ρᵐ/m for κ = 0."""
    order = np.arange(_ORDERS + 1)
    if mode == 0:
        return radii[:, None] ** order / np.maximum(order, 1)
    at_wall = _log_bessel(order, np.full(order.shape, mode))
    next_order = np.exp(_log_bessel(order + 1, np.full(order.shape, mode)) - at_wall)
    log_inside = _log_bessel(order, mode * radii[:, None])
    return np.exp(log_inside - at_wall) / (order + mode * next_order)


def _log_bessel(order: Indices, argument: Array) -> Array:
    """Logarithm of I_m(x); for larger m, where I_m underflows, by Debye's uniform expansion (DLMF 10.41.3)."""
    m, x = np.broadcast_arrays(order.astype(np.float64), argument)
    log = np.empty(m.shape)
    low = m < _UNIFORM
    log[low] = np.log(ive(m[low], x[low])) + x[low]
    m, z = m[~low], x[~low] / m[~low]
    root = np.sqrt(1 + z**2)
    p = 1 / root
    terms = (3 * p - 5 * p**3) / 24 / m + (81 * p**2 - 462 * p**4 + 385 * p**6) / 1152 / m**2
    log[~low] = m * (root + np.log(z / (1 + root))) - np.log(2 * np.pi * m * root) / 2 + np.log1p(terms)
    return log
