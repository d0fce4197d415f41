"""Noise of the readings and of the images, and the health of every electrode contact."""

from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.analysis.defects.quality import largest_by_reading, reciprocity_errors, signal_to_noise_dB
from cbsr_qa.domain.numbers import Array
from cbsr_qa.plugin import Block, Cell, Figure, Measurement, Outcome, RunObservation, RunResult, Table
from cbsr_qa.report.draw.channels import channel_map_figure, pair_bar_figure
from cbsr_qa.report.section import ObservedSection
from cbsr_qa.report.tables import limit_text, number, quantity, scale_unit, text_table, value_cell

#: Measurements that belong here, by the beginning of their name.
_WORDS: Final = ("noise", "conductance_noise", "channel", "reciprocity", "drift", "contact", "interelectrode")


#: Pairs within this share of their median are not named.
_ALIKE = 0.01


class NoiseAndContacts(ObservedSection):
    """Section of noise figure, noise floor, signal-to-noise ratio per channel and resistance per electrode pair."""

    title = "Noise and contacts"

    def run_blocks(self, result: RunResult, run: RunObservation) -> Iterator[Block]:
        """Return a table, then a figure for each quantity that was measured."""
        yield _table(result, run)
        ratio_dB = signal_to_noise_dB(run.unloaded)
        if ratio_dB is not None:
            yield _channels(run, ratio_dB)
        pairs, errors = reciprocity_errors(run.reference, run.record.sensor_type.pattern, run.usable)
        if errors.size:
            yield _reciprocity(run, pairs, errors)
        contacts = [m for m in result.measurements if m.name == "contact_resistance" and m.dimensions.pair]
        if any(m.value is not None for m in contacts):
            yield _contacts(contacts)


def _table(result: RunResult, run: RunObservation) -> Table:
    own = [m for m in result.measurements if m.name.startswith(_WORDS) and not m.location]
    # Single pairs and readings are drawn.
    whole = [m for m in own if m.dimensions.pair is None and m.dimensions.drive is None]
    rows: list[list[str | Cell]] = [
        [m.label, m.phase or "whole run", value_cell(m, unit=True), limit_text(m.limit) if m.limit else "–", m.how]
        for m in whole
    ]
    if not any(m.name == "noise_floor" for m in whole):
        floor = f"largest |value| of any element in {len(run.noise_images)} unloaded images"
        rows.append(["noise floor", "whole run", number(run.noise_floor), "–", floor])
    columns = ("Quantity", "Phase", "Value", "Limit", "How")
    return text_table("Noise of readings and images.", columns, rows, (2, 3))


def _channels(run: RunObservation, ratio_dB: Array) -> Figure:
    used = ratio_dB[run.usable & np.isfinite(ratio_dB)]
    words = "no usable reading" if not used.size else f"median {np.median(used):.0f} dB, lowest {used.min():.0f} dB"
    return Figure(
        f"Signal-to-noise ratio of each reading on the rested sheet ({len(run.unloaded)} frames): {words}. Grey:"
        " readings that are not imaged.",
        f"Map of {run.usable.shape[0]} drive by {run.usable.shape[1]} measure pairs; {words}.",
        channel_map_figure(ratio_dB, label="signal-to-noise ratio", unit="dB", used=run.usable),
    )


def _reciprocity(run: RunObservation, pairs: NDArray[np.int64], errors: Array) -> Figure:
    largest = largest_by_reading(pairs, errors, run.usable.shape)
    words = f"rms {number(100 * float(np.sqrt(np.mean(errors**2))), 2)} %, largest {number(100 * errors.max(), 2)} %"
    return Figure(
        "Change of each reading of the reference frame when drive and measure pair are exchanged, relative to the rms"
        f" reading: {words}. A row and column that stand out point to a contact, a triangle to reading memory.",
        f"Map of {run.usable.shape[0]} drive by {run.usable.shape[1]} measure pairs; {words}.",
        channel_map_figure(100 * largest, label="reciprocity error", unit="%", used=largest >= 0),
    )


def _pair(measurement: Measurement) -> str:
    return "-".join(map(str, measurement.dimensions.pair or ()))


def _contacts(pairs: Sequence[Measurement]) -> Figure:
    """Draw the pairs with a value; those without are named in the caption."""
    known = [m for m in pairs if m.value is not None]
    lost = [_pair(m) for m in pairs if m.value is None]
    values = np.array([m.value for m in known], dtype=np.float64)
    median, measured_in = float(np.median(values)), pairs[0].unit
    scale, unit = scale_unit(median, measured_in)
    limit = next((m.limit for m in pairs if m.limit is not None), None)
    low, high = (None, None) if limit is None else (limit.lower, limit.upper)
    worst = int(np.abs(np.log(np.maximum(values, 1e-12) / max(median, 1e-12))).argmax())
    furthest = f"furthest from it pair {_pair(known[worst])} with {quantity(values[worst], measured_in)}"
    if median and abs(values[worst] / median - 1) < _ALIKE:
        furthest = f"all pairs within {100 * _ALIKE:g} % of it"
    words = f"median {quantity(median, measured_in)}, {furthest}"
    words += f"; without a value: {', '.join(lost)}" if lost else ""
    return Figure(
        f"Resistance of each electrode pair on the rested sheet, contacts included: {words}. One electrode with a bad"
        " contact raises both pairs it belongs to.",
        f"Bars of {len(known)} electrode pairs; {words}.",
        pair_bar_figure(
            values / scale,
            [_pair(m).replace("-", "–") for m in known],
            label="resistance",
            unit=unit,
            limits=(None if low is None else low / scale, None if high is None else high / scale),
            outside=[rank for rank, m in enumerate(known) if m.outcome is Outcome.FAIL],
        ),
    )
