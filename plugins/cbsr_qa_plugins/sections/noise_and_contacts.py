"""Noise of the readings and of the images, and the health of every electrode contact."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain.frames import VoltageUnit
from cbsr_qa.domain.load_events import RecordingResult
from cbsr_qa.domain.measurement import Measurement
from cbsr_qa.domain.observation import RunObservation
from cbsr_qa.domain.outcome import Outcome
from cbsr_qa.domain.report import Block, Cell, Figure, Paragraph, RunResult, Section, Table
from cbsr_qa.report.figures_channels import channel_map_figure, pair_bar_figure
from cbsr_qa.report.numbers import number, quantity, scaled_unit
from cbsr_qa.report.select import observed
from cbsr_qa.report.tables import limit_text, text_table, value_cell

#: Measurements that belong here, by the beginning of their name.
_WORDS: Final = ("noise", "image_noise", "channel", "reading_noise", "snr", "signal_to_noise", "reciprocity", "drift")
_CONTACT: Final = ("contact", "interelectrode")


class NoiseAndContacts:
    """Section of noise figure, noise floor, signal-to-noise ratio per channel and resistance per electrode pair."""

    def render(self, result: RunResult | RecordingResult) -> Section | None:
        """Return the section; None where nothing could be analysed."""
        run = observed(result)
        if run is None or not isinstance(result, RunResult):
            return None
        blocks: list[Block] = [_table(result, run)]
        ratio_dB = signal_to_noise_dB(run)
        if ratio_dB is not None:
            blocks.append(_channels(run, ratio_dB))
        resistance_ohm = pair_resistance_ohm(run)
        if resistance_ohm is None:
            why = "The drive current is not stated, or no pair is measured while it is driven: no contact resistance."
            blocks.append(Paragraph(why, "note"))
        else:
            contacts = [m for m in result.measurements if m.name.startswith(_CONTACT)]
            blocks.append(_contacts(resistance_ohm, contacts))
        return Section("Noise and contacts", tuple(blocks))


def signal_to_noise_dB(run: RunObservation) -> NDArray[np.float64] | None:
    """Level over rms noise of every reading of the rested sheet [dB], (drives, measures).

    Returns
    -------
    Infinite where a reading never changed; None with fewer than three unloaded frames.
    """
    if len(run.unloaded) < 3:
        return None
    level = np.abs(run.unloaded.voltages.mean(axis=0))
    noise = run.unloaded.voltages.std(axis=0, ddof=1)
    tiny = np.finfo(np.float64).tiny
    ratio: NDArray[np.float64] = 20 * np.log10(np.maximum(level, tiny) / np.maximum(noise, tiny))
    return np.where(noise > 0, ratio, np.inf)


def pair_resistance_ohm(run: RunObservation) -> NDArray[np.float64] | None:
    """Resistance of each electrode pair [Ω] from the reading across it while it is driven, contacts included.

    Returns
    -------
    (drives,) float64; None where the current is unknown, the readings are counts, or no pair measures itself.
    """
    pattern, current = run.record.sensor_type.pattern, run.unloaded.current_A
    own = [pattern.measure.index(pair) if pair in pattern.measure else -1 for pair in pattern.drive]
    if not current or run.unloaded.unit is not VoltageUnit.VOLT or min(own) < 0:
        return None
    driven: NDArray[np.float64] = run.reference[np.arange(len(own)), own]
    return np.abs(driven) / abs(current)


def _table(result: RunResult, run: RunObservation) -> Table:
    found = [m for m in result.measurements if m.name.startswith((*_WORDS, *_CONTACT)) and not m.location]
    rows: list[list[str | Cell]] = [
        [m.label, m.phase or "whole run", value_cell(m, unit=True), limit_text(m.limit) if m.limit else "–", m.how]
        for m in found
    ]
    floor = f"largest of {len(run.noise_images)} unloaded images over the whole sheet"
    rows.append(["noise floor of the images", "unloaded", f"{number(100 * run.noise_floor)} %", "–", floor])
    columns = ("Quantity", "Phase", "Value", "Limit", "How")
    return text_table("Noise of readings and images.", columns, rows, (2, 3))


def _channels(run: RunObservation, ratio_dB: NDArray[np.float64]) -> Figure:
    used = ratio_dB[run.usable & np.isfinite(ratio_dB)]
    told = "no usable reading" if not used.size else f"median {np.median(used):.0f} dB, lowest {used.min():.0f} dB"
    return channel_map_figure(
        ratio_dB,
        label="level over noise",
        unit="dB",
        used=run.usable,
        caption=f"Signal-to-noise ratio of each reading on the rested sheet ({len(run.unloaded)} frames): {told}."
        " Grey: readings that are not imaged.",
        alternative=f"Map of {run.usable.shape[0]} drive by {run.usable.shape[1]} measure pairs; {told}.",
    )


def _contacts(resistance_ohm: NDArray[np.float64], measured: list[Measurement]) -> Figure:
    median = float(np.median(resistance_ohm))
    scale, unit = scaled_unit(median, "ohm")
    limit = next((m.limit for m in measured if m.limit is not None and m.limit.unit in ("ohm", "Ω")), None)
    bounds = (None, None) if limit is None else (limit.lower, limit.upper)
    outside = (
        [] if limit is None else [k for k, r in enumerate(resistance_ohm) if limit.judge(float(r)) is Outcome.FAIL]
    )
    worst = int(np.abs(np.log(np.maximum(resistance_ohm, 1e-12) / max(median, 1e-12))).argmax())
    told = (
        f"median {quantity(median, 'ohm')}, furthest from it pair {worst}–{(worst + 1) % len(resistance_ohm)}"
        f" with {quantity(float(resistance_ohm[worst]), 'ohm')}"
    )
    low, high = (None if bound is None else bound / scale for bound in bounds)
    return pair_bar_figure(
        resistance_ohm / scale,
        label="resistance",
        unit=unit,
        limits=(low, high),
        outside=outside,
        caption=f"Resistance of each electrode pair on the rested sheet, contacts included: {told}. One electrode"
        " with a bad contact raises both pairs it belongs to.",
        alternative=f"Bars of {len(resistance_ohm)} electrode pairs; {told}.",
    )
