"""Residue of releases that outlasts the material's relaxation, found from the levels of the rests."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.special import fdtrc

from cbsr_qa.calibration.fits.superposition import (
    SeparatedSteps,
    StepTrace,
    constants_of,
    separate_steps,
    separate_with_constants,
)
from cbsr_qa.domain.numbers import Array

_SIGNIFICANCE: Final = 0.01
_CLEAR: Final = 3.0
_FEWEST: Final = 6  # rests; fewer do not determine a slow decay
_ROUNDS: Final = 2


@dataclass(frozen=True, slots=True, eq=False)
class SlowResidue:
    """A share of every released change remains, and decays with one time constant.

    Parameters
    ----------
    share, decay_s : share of the release that is left, and its τ.
    covariance : (2, 2) covariance of (share, log τ).
    """

    share: float
    decay_s: float
    covariance: Array

    def shift_parameters(self) -> list["SlowResidue"]:
        """Return it moved by one standard error along each of its independent directions."""
        size, direction = np.linalg.eigh(self.covariance)
        shifts = np.sqrt(np.maximum(size, 0)) * direction
        return [
            replace(self, share=self.share + float(d), decay_s=self.decay_s * float(np.exp(np.clip(log, -1, 1))))
            for d, log in shifts.T
        ]


def changes_of(separated: SeparatedSteps, steps: Sequence[StepTrace]) -> Array:
    """Steady change (presses,) from the final level of the rest before a press to that of its hold."""
    levels_before = np.concatenate([[0.0], separated.levels[1::2]])[: len(steps[0::2])]
    changes: Array = separated.levels[0::2] - levels_before
    return changes


def subtract_residue(steps: Sequence[StepTrace], changes: Array, residue: SlowResidue | None) -> list[StepTrace]:
    """Subtract a residue of known changes from all steps."""
    if residue is None:
        return list(steps)
    units = _unit_residues(steps, changes, residue.decay_s)
    return [replace(step, values=step.values - residue.share * unit) for step, unit in zip(steps, units, strict=True)]


def separate_with_residue(steps: Sequence[StepTrace]) -> tuple[SeparatedSteps, SlowResidue | None]:
    """Separate steps, and subtract a significant residue that outlasts them.

    Residues of earlier releases decay during a hold, whose level is then too low relative to the rest before: with 2
    % that decay in ten minutes, steady changes of ten cycles are 1.4 % low. They show in the levels of the rests,
    which rise from cycle to cycle. It is kept if an F test finds it significant at 1 % and its share is three
    standard errors from zero.
    """
    separated = as_read = separate_steps(steps)
    residue: SlowResidue | None = None
    for _ in range(_ROUNDS):
        changes = changes_of(separated, steps)
        residue = _residue(steps, as_read, changes)
        if residue is None:
            return separate_steps(steps), None
        separated = separate_steps(subtract_residue(steps, changes, residue))
        as_read = separate_with_constants(steps, separated.common, constants_of(separated.common))
    return separated, residue


def _residue(steps: Sequence[StepTrace], separated: SeparatedSteps, changes: Array) -> SlowResidue | None:
    levels, errors = separated.levels[1::2], separated.level_stderr[1::2]
    if len(levels) < _FEWEST or not (errors > 0).all() or not changes.any():
        return None
    target = levels / errors

    def model(log_s: float) -> Array:
        residues = _unit_residues(steps, changes, float(np.exp(log_s)))
        units = [replace(step, values=unit) for step, unit in zip(steps, residues, strict=True)]
        return separate_with_constants(units, separated.common, constants_of(separated.common)).levels[1::2] / errors

    def misfit_at(log_s: float) -> float:
        unit = model(log_s)
        return float(target @ target - (unit @ target) ** 2 / max(float(unit @ unit), 1e-300))

    slowest_s = max((max(c, default=0.0) for c in constants_of(separated.common).values()), default=0.0)
    length_s = steps[-1].start_s - steps[0].start_s
    lowest, highest = np.log(max(3 * slowest_s, 60.0)), np.log(10 * max(length_s, 60.0))
    if lowest >= highest:
        return None
    grid = np.linspace(lowest, highest, 13)
    middle = int(np.argmin([misfit_at(float(log_s)) for log_s in grid]))
    ends = (float(grid[max(middle - 1, 0)]), float(grid[min(middle + 1, len(grid) - 1)]))
    log_s = float(minimize_scalar(misfit_at, bounds=ends, method="bounded").x)
    return _accept_residue(log_s, model, target, misfit_at(log_s))


def _accept_residue(log_s: float, model: Callable[[float], Array], target: Array, rest: float) -> SlowResidue | None:
    unit = model(log_s)
    share = float(unit @ target) / float(unit @ unit)
    slope = share * (model(log_s + 0.05) - model(log_s - 0.05)) / 0.1
    freedom = len(target) - 2
    gain = (float(target @ target) - rest) / 2 / (rest / freedom)
    jacobian = np.column_stack([unit, slope])
    covariance = np.linalg.pinv(jacobian.T @ jacobian) * max(rest / freedom, 1.0)
    is_clear = (
        share > _CLEAR * float(np.sqrt(covariance[0, 0])) and fdtrc(2, freedom, max(gain, 0.0)) <= _SIGNIFICANCE
    )
    return SlowResidue(share, float(np.exp(log_s)), np.asarray(covariance, dtype=np.float64)) if is_clear else None


def _unit_residues(steps: Sequence[StepTrace], changes: Array, decay_s: float) -> list[Array]:
    """Residue of unit shares of all earlier releases at the samples of each step."""
    carried, before_s = 0.0, steps[0].start_s if steps else 0.0
    residues = []
    for number, step in enumerate(steps):
        carried *= float(np.exp(-(step.start_s - before_s) / decay_s))
        before_s = step.start_s
        if not step.loading:
            carried += float(changes[number // 2])
        residues.append(carried * np.exp(-step.time_s / decay_s))
    return residues
