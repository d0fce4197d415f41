"""Electrode contacts: two-wire resistance of each driven pair, and reciprocity of the reference frame."""

from typing import ClassVar

import numpy as np

from cbsr_qa.analysis.defects.quality import reciprocity_errors
from cbsr_qa.plugin import (
    UNUSABLE,
    Dimensions,
    Measurement,
    PluginOptions,
    ReadingFlag,
    RunObservation,
    VoltageUnit,
    WithOptions,
)


class ReciprocityError(WithOptions):
    """``reciprocity_error`` [1] of the reference frame: rms |V_ij − V_ji| over rms |V| of the imaged readings.

    Of patterns that drive other pairs than they measure the readings that are still reciprocal to each other are
    taken, see :meth:`cbsr_qa.domain.sensor.DrivePattern.reciprocal_pairs`.

    Multiplexers that keep a share of the previous reading break reciprocity too: a large value is a reason to look,
    not yet an electrode fault. With qualifier ``"worst"`` the largest |V_ij − V_ji| over the same rms.

    Parameters
    ----------
    every : whether each pair's error is reported too, ``"drive 3, measure 7"``.
    """

    class Options(PluginOptions):
        every: bool = False

    measures: ClassVar[dict[str, str]] = {"reciprocity_error": "1"}
    options: Options

    def measure_run(self, run: RunObservation) -> tuple[Measurement, ...]:
        """Measure; patterns without reciprocal readings have no value."""
        pairs, errors = reciprocity_errors(run.reference, run.record.sensor_type.pattern, run.usable)
        if not errors.size:
            why = "no imaged reading has a reciprocal one, or all are zero"
            return tuple(Measurement("reciprocity_error", None, "1", qualifier=q, how=why) for q in ("", "worst"))
        drives, measures = (index.tolist() for index in np.divmod(pairs[:, 0], run.usable.shape[1]))
        names = [Dimensions(drive=d, measure=m).text for d, m in zip(drives, measures, strict=True)]
        worst = int(errors.argmax())
        together = f"rms over {errors.size} pairs of readings of the reference frame"
        values = [("", np.sqrt(np.mean(errors**2)), together), ("worst", errors[worst], names[worst])]
        if self.options.every:
            values += [(name, e, "against its reciprocal reading") for name, e in zip(names, errors, strict=True)]
        return tuple(
            Measurement("reciprocity_error", float(value), "1", qualifier=qualifier, how=how)
            for qualifier, value, how in values
        )


class ContactResistance:
    """``contact_resistance`` [Ω] V_kk / I of each driven pair, and what they say together.

    Together: ``interelectrode_resistance`` [Ω], their median with their deviation (the paper's R_int), and
    ``contact_resistance_ratio`` [1], largest over median, whose ``how`` names the worst pair. The readings are the
    reference frame's that are driven and measured by one pair. It has no options.
    """

    measures: ClassVar[dict[str, str]] = {
        "contact_resistance": "Ω",
        "interelectrode_resistance": "Ω",
        "contact_resistance_ratio": "1",
    }

    def measure_run(self, run: RunObservation) -> tuple[Measurement, ...]:
        """Measure; a pair at the source's limit, or frames without volts and current, give no value."""
        why = _why_not(run)
        if why:
            return _together([], why)
        current_A = run.unloaded.current_A
        assert current_A is not None
        pairs = [_pair(run, drive, measure, name, current_A) for drive, measure, name in _list_driven_pairs(run)]
        return (*pairs, *_together(pairs, "no pair has a reading that can be used"))


def _why_not(run: RunObservation) -> str:
    if run.unloaded.unit is not VoltageUnit.VOLT:
        return f"frames are in {run.unloaded.unit}, not in volts"
    if not run.unloaded.current_A:
        return "the drive current is not known"
    if not _list_driven_pairs(run):
        return "no driven pair is measured itself by this pattern"
    return ""


def _list_driven_pairs(run: RunObservation) -> list[tuple[int, int, str]]:
    """Row, column and name of every reading that is driven and measured by one pair."""
    pattern = run.record.sensor_type.pattern
    column = {pair: index for index, pair in enumerate(pattern.measure)}
    return [(row, column[p], Dimensions(pair=p).text) for row, p in enumerate(pattern.drive) if p in column]


def _pair(run: RunObservation, drive: int, measure: int, name: str, current_A: float) -> Measurement:
    flags = run.unloaded.flags[:, drive, measure]
    if (flags & np.uint8(UNUSABLE)).any():
        seen = ReadingFlag(int(np.bitwise_or.reduce(flags)) & UNUSABLE)
        how = f"the reading is marked {str(seen.name).lower()}: the contact's resistance is not known"
        return Measurement("contact_resistance", None, "Ω", qualifier=name, how=how)
    readings = run.unloaded.voltages[:, drive, measure] / current_A
    value = abs(float(run.reference[drive, measure])) / abs(current_A)
    scatter = float(readings.std(ddof=1)) / len(readings) ** 0.5 if len(readings) > 1 else None
    return Measurement(
        "contact_resistance", value, "Ω", scatter, qualifier=name, how="two-wire: sheet, both contacts and leads"
    )


def _together(pairs: list[Measurement], why: str) -> tuple[Measurement, Measurement]:
    known = [(pair.value, pair.qualifier) for pair in pairs if pair.value is not None]
    if not known:
        return (
            Measurement("interelectrode_resistance", None, "Ω", how=why),
            Measurement("contact_resistance_ratio", None, "1", how=why),
        )
    values = np.array([value for value, _ in known])
    middle, (largest, worst) = float(np.median(values)), max(known)
    deviation = float(values.std(ddof=1)) if len(values) > 1 else None
    lost = len(pairs) - len(known)
    how = f"median of {len(known)} pairs, with their deviation" + (f"; {lost} without value" if lost else "")
    together = Measurement("interelectrode_resistance", middle, "Ω", deviation, how=how)
    if lost or middle == 0:
        reason = f"{lost} of {len(pairs)} pairs have no value" if lost else "the median pair reads zero volts"
        return together, Measurement("contact_resistance_ratio", None, "1", how=reason)
    return together, Measurement(
        "contact_resistance_ratio", largest / middle, "1", how=f"largest: {worst}, {largest / 1e3:.4g} kΩ"
    )
