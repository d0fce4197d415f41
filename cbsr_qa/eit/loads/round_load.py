"""Readings of a sheet under one round load, and their derivatives, without a mesh for the load.

With A_m the coefficients of the field around a disc, its own field outside consists of poles −D_m conj(A_m)/(z −
c)^m, D_m = μ r²ᵐ, μ = (γ_i − γ)/(γ_i + γ). The response of edge and electrodes couples the orders
(:class:`Expansion`): one small dense system per load. The readings change by −2π Σ m D_m Re(A_m conj E_m) with E the
field of the sheet without the load, by reciprocity; all derivatives are such sums of A alone (the shape derivative of
a transmission problem, integrated round the circle).

A load is described by its *strength* s = μ r² and the *square* q = r² of its radius: D_m = s qᵐ⁻¹ is a polynomial, so
that least-squares estimates of s and q are nearly unbiased, and q may pass through zero on its way.
"""

from dataclasses import dataclass
from math import ceil, log
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.numbers import Array, Indices
from cbsr_qa.domain.sensor.patterns import DrivePattern

_ERROR = 1e-5  # of the series if every order were as strong as the first; usually below 1e-6
_FEWEST, _MOST = 4, 16  # orders
_DETUNED = 1e-9
_SMALLEST_REACH = 1e-3  # of the sheet's radius: keeps powers in range for q near zero


@dataclass(frozen=True, slots=True, eq=False)
class Expansion:
    """Fields about n places, as coefficients of (w/reach)^m, m = 1 … orders, with w the way from the place.

    Parameters
    ----------
    orders : M.
    fields : (n, 2M, electrodes) of a unit current into each electrode [V/A]; meaningful only for currents that sum to
        zero.
    response : (n, 2M, 2M), response of edge and pins: a disc at the place whose poles are −D_m reach^m conj(A_m) in a
        field with coefficients A sees A = fields − response · D · A.
    """

    orders: int
    fields: Array
    response: Array


class Surroundings(Protocol):
    """A sheet without the load."""

    @property
    def radius_mm(self) -> float:
        """Size of the sheet [mm]."""
        ...

    @property
    def extent_mm(self) -> tuple[float, float, float, float]:
        """Lowest and highest x, lowest and highest y."""
        ...

    def clearance_mm(self, place_mm: Array) -> Array:
        """Radius (n,) of the largest disc about each place (n, 2) that touches neither edge nor electrode [mm]."""
        ...

    def fields(self, place_mm: Array, reach_mm: Array, orders: int) -> Array:
        """The fields of :meth:`expansion` alone."""
        ...

    def expansion(self, place_mm: Array, reach_mm: Array, orders: int) -> Expansion:
        """Fields about places (n, 2), in powers of the way over ``reach_mm`` (n,)."""
        ...

    def transfer_impedance(self) -> Array:
        """Electrode potentials per electrode current [Ω] at unit sheet conductance, of the unloaded sheet."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class RoundLoads:
    """One load each in n sheets.

    Parameters
    ----------
    place_mm : (n, 2) centres.
    strength_mm2 : (n,) s = μ r².
    square_mm2 : (n,) q = r².
    """

    place_mm: Array
    strength_mm2: Array
    square_mm2: Array

    @classmethod
    def from_contrast(cls, place_mm: Array, radius_mm: Array, contrast: Array) -> "RoundLoads":
        """Loads of radius (n,) and relative conductance change κ = Δγ/γ (n,), above −1."""
        square = np.asarray(radius_mm, dtype=np.float64) ** 2
        return cls(np.asarray(place_mm, dtype=np.float64), square * contrast / (2 + np.asarray(contrast)), square)


@dataclass(frozen=True, slots=True, eq=False)
class LoadReadings:
    """Changes of readings.

    Parameters
    ----------
    change : (n, drives, measures) [V/A] at unit sheet conductance.
    slope : (n, 4, drives, measures) per x [mm], y [mm], strength [mm²] and square [mm²].
    """

    change: Array
    slope: Array


class RoundLoadModel:
    """Changes of the readings under round loads.

    Parameters
    ----------
    surroundings : the sheet.
    pattern : drive and measure pairs.
    """

    def __init__(self, surroundings: Surroundings, pattern: DrivePattern) -> None:
        self.surroundings = surroundings
        self.pattern = pattern
        self._drive, self._measure = pattern.drive_currents(), pattern.measure_matrix()

    def solve_unloaded(self) -> Array:
        """Readings of the sheet without a load, (drives, measures) [V/A]."""
        return (self.surroundings.transfer_impedance() @ self._drive).T @ self._measure

    def readings(self, loads: RoundLoads) -> LoadReadings:
        """Changes of the readings, and their slopes, for each of n loads pressed alone.

        Raises
        ------
        NumericsError
            If a load's place, strength or size is not finite, or its centre is on an electrode or off the sheet,
            where the field has no power series.
        """
        self._check(loads)
        reach, order, growth = self._series(loads)
        orders = len(order)
        around = self.surroundings.expansion(loads.place_mm, reach, orders)
        strength = (loads.strength_mm2 / reach**2)[:, None]
        poles = np.tile(strength * growth, 2)  # D_m, for both real and imaginary parts
        pole_fields = _solve_fields(around.response * poles[:, None] + np.eye(2 * orders), around.fields)
        drive, measure = pole_fields @ self._drive, pole_fields @ self._measure
        weight = -2 * np.pi * np.tile(order, 2)
        change = _gram(around.fields @ self._drive, weight * poles, measure)
        less = np.concatenate([np.zeros_like(strength), growth[:, :-1]], axis=1) * (order - 1)
        area = reach[:, None] ** 2
        by_strength = _gram(drive, weight * np.tile(growth, 2) / area, measure)
        by_square = _gram(drive, weight * np.tile(strength * less, 2) / area, measure)
        step = weight[: orders - 1] * order[1:] * poles[:, : orders - 1] / reach[:, None]
        by_x, by_y = _place_slopes(drive, step, measure)
        return LoadReadings(change, np.stack([by_x, by_y, by_strength, by_square], axis=1))

    def weak(self, place_mm: Array, radius_mm: Array) -> Array:
        """Changes per strength of loads too weak to disturb any field: (n, drives, measures) [V/A per mm²]."""
        nothing = np.zeros(len(place_mm))
        loads = RoundLoads(np.asarray(place_mm, dtype=np.float64), nothing, np.asarray(radius_mm) ** 2)
        reach, order, growth = self._series(loads)
        fields = self.surroundings.fields(loads.place_mm, reach, len(order))
        weight = -2 * np.pi * np.tile(order * growth, 2) / reach[:, None] ** 2
        return _gram(fields @ self._drive, weight, fields @ self._measure)

    def _check(self, loads: RoundLoads) -> None:
        load_rows = np.column_stack([loads.place_mm, loads.strength_mm2, loads.square_mm2])
        if not np.isfinite(load_rows).all():
            raise NumericsError(
                "a load's place, strength or size is not a finite number",
                remedy="for a perfect conductor use the squared radius as strength",
            )
        bad_loads = np.flatnonzero(self.surroundings.clearance_mm(loads.place_mm) <= 0)
        if bad_loads.size:
            x_mm, y_mm = loads.place_mm[bad_loads[0]].tolist()
            raise NumericsError(
                f"a load at ({x_mm:zg}, {y_mm:zg}) mm has its centre on an electrode or off the sheet: its field has"
                " no power series",
                remedy="press clear of the electrodes, or use a mesh",
            )

    def _series(self, loads: RoundLoads) -> tuple[Array, Indices, Array]:
        """Reach of each load (n,) [mm], orders m (M,), and (square/reach²)^(m − 1), (n, M)."""
        reach = np.maximum(np.sqrt(np.abs(loads.square_mm2)), _SMALLEST_REACH * self.surroundings.radius_mm)
        clearance = self.surroundings.clearance_mm(loads.place_mm)
        ratio = float((reach / np.maximum(clearance, reach * 1.05)).max(initial=0.0))
        order_count = ceil(log(_ERROR) / (2 * log(ratio))) + 1 if ratio > 0 else _FEWEST
        order = np.arange(1, int(np.clip(order_count, _FEWEST, _MOST)) + 1)
        return reach, order, (loads.square_mm2 / reach**2)[:, None] ** (order - 1)


def _solve_fields(system: Array, fields: Array) -> Array:
    """Fields with the load; an unphysical resonant strength counts as a very large field."""
    try:
        return np.asarray(np.linalg.solve(system, fields), dtype=np.float64)
    except np.linalg.LinAlgError:
        detuned = system + _DETUNED * np.eye(system.shape[1])
        return np.asarray(np.linalg.solve(detuned, fields), dtype=np.float64)


def _gram(drive: Array, weight: NDArray[np.floating[Any]], measure: Array) -> Array:
    """Σ_m weight_m drive_m measure_m for every pair of columns: (n, drives, measures)."""
    return np.swapaxes(drive * weight[..., None], 1, 2) @ measure


def _place_slopes(drive: Array, step: Array, measure: Array) -> tuple[Array, Array]:
    """Slopes along x and y: Re(v (A_{m+1} conj A'_m + A'_{m+1} conj A_m)) summed with weights, v = 1 and i."""
    orders = step.shape[1] + 1
    blocks = [values[:, block] for values in (drive, measure) for block in (slice(0, orders), slice(orders, None))]
    dr, di, mr, mi = ((values[:, :-1], values[:, 1:]) for values in blocks)  # (lower, upper) orders
    by_x = _gram(dr[1], step, mr[0]) + _gram(di[1], step, mi[0])
    by_x += _gram(dr[0], step, mr[1]) + _gram(di[0], step, mi[1])
    by_y = _gram(dr[1], step, mi[0]) - _gram(di[1], step, mr[0])
    by_y += _gram(di[0], step, mr[1]) - _gram(dr[0], step, mi[1])
    return by_x, by_y
