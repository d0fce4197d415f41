"""Report of a batch's model: how alike its sensors are, what stands out, scatter and drift."""

from collections.abc import Iterator
from functools import partial
from typing import Final

from cbsr_qa.domain.results.report import Banner, Block, CommandOutcome, Figure, Page, Paragraph, Section, Table
from cbsr_qa.report.tables import list_names, number, plural, text_table
from cbsr_qa.studies.batch.study import BatchStudy

_NONE: Final = "–"
_HEADLINE: Final = "{percent} % of what maps vary by is common to the batch ({low} to {high} %)"
_REASON: Final = (
    "a sensor of the batch that was not yet pressed is known to {before} %, after {presses} presses to {after} %;"
    " maps vary by {deviation} % over {length} mm"
)
_STANDS_OUT: Final = (
    "not like the others: {names}. The model rests on {them} too, and so states less in common; to see it without:"
    " --without SERIAL"
)
_DRIFT: Final = "the {name} drifts over the batch: {drift} from one sensor to the next (p = {p:.2g})"
_WITH_PRIOR: Final = (
    "{count} took an earlier model of the batch as prior ({names}): only their presses count here, not the maps "
    "learned with it; short ones are predicted with that model's relaxation, relaxation is taken from other runs"
)
_LEFT_OUT: Final = "{count} left out: {runs}"
_WIDE: Final = "the interval is wide: more sensors, rather than more presses, narrow it"
_WIDE_FROM: Final = 0.5
_READING: Final = (
    "The response of each sensor is a common map, its own map and a level. ρ is the share of the maps' variance"
    " that two sensors have in common: 0 if sensors of the batch differ as much as those of other batches, 1 if they"
    " are identical. Its interval has a confidence of 95 %.",
    'The odds weigh "like the others" against "of another batch"; p is the probability that a sensor like the'
    " others has odds as low, where the others alone decide. A sensor stands out if p, adjusted for all sensors"
    " (Holm), is below 0.05.",
)
_MAPS: Final = (
    "The common map, then each sensor's by its own presses and the others; dots are presses, names in red stand out."
)
_SENSORS: Final = (
    "Level and standard error against the mean of all; deviation of its map from the common one; p of so much"
    ' difference; ln of the odds of "like the others" against "of another batch".'
)
_QUANTITIES: Final = "Scatter over the sensors, and change from one sensor to the next in the order of runs, 95 %."
_EXPECTED: Final = "Expected error of one more sensor's response, by its presses (places far apart)."
_LEFT: Final = "Runs of the batch that the model does not rest on."


def batch_outcome(study: BatchStudy) -> CommandOutcome[BatchStudy]:
    """Lay a batch's model out."""
    sections = [
        Section("How to read this page", tuple(map(Paragraph, _READING)), page_only=True),
        Section("Sensors", tuple(_sensor_blocks(study))),
        Section("Scatter and drift", (_list_quantities(study),)),
        Section("The next sensor", (_list_expected(study),)),
    ]
    if study.left_out:
        rows = [(run.serial, run.run, run.why) for run in study.left_out]
        sections.append(Section("Left out", (text_table(_LEFT, ("sensor", "run", "why"), rows),)))
    return CommandOutcome(study, _page(study), tuple(sections))


def _page(study: BatchStudy) -> Page:
    rho = study.rho
    percents = {
        name: _percent(getattr(rho, field), 0)
        for name, field in (("percent", "value"), ("low", "low"), ("high", "high"))
    }
    fewest = study.expected[min(1, len(study.expected) - 1)]
    reason = _REASON.format(
        before=_percent(study.expected[0].error),
        presses=fewest.presses,
        after=_percent(fewest.error),
        deviation=_percent(study.map_deviation, 0),
        length=number(study.length_mm, 2),
    )
    facts = (
        ("Batch", study.batch),
        ("Sensors", f"{len(study.sensors)} of type {study.sensor_type}, material {study.material}"),
        ("Presses", f"{sum(sensor.loads for sensor in study.sensors)} at {len(study.model.loads.places_mm)} places"),
        ("Model", f"SHA-256 {study.digest[:16]}…"),
    )
    banner = Banner("plain", "●", _HEADLINE.format(**percents), reason)
    warnings = tuple(_list_warnings(study))
    return Page("Batch model", study.batch, banner, facts, study.simulated, warnings)


def _list_warnings(study: BatchStudy) -> Iterator[str]:
    odd = [sensor.serial for sensor in study.sensors if sensor.stands_out]
    if odd:
        yield _STANDS_OUT.format(names=list_names(odd), them="it" if len(odd) == 1 else "them")
    for quantity in study.quantities:
        if quantity.drifts:
            yield _DRIFT.format(name=quantity.name, drift=_amount(quantity.drift, quantity.unit), p=quantity.drift_p)
    if study.rho.high - study.rho.low > _WIDE_FROM:
        yield _WIDE
    with_prior = [sensor.serial for sensor in study.sensors if sensor.prior]
    if with_prior:
        yield _WITH_PRIOR.format(count=plural(len(with_prior), "run"), names=list_names(with_prior))
    if study.left_out:
        runs = list_names([f"{run.serial} ({run.why})" for run in study.left_out])
        yield _LEFT_OUT.format(count=plural(len(study.left_out), "run"), runs=runs)


def _sensor_blocks(study: BatchStudy) -> Iterator[Block]:
    rows = [
        (
            sensor.serial,
            str(sensor.loads),
            f"{100 * sensor.level:+.1f} ± {100 * sensor.level_stderr:.1f} %".replace("-", "\N{MINUS SIGN}"),
            f"{_percent(sensor.deviation)} %",
            f"{sensor.p_value:.2g}",
            f"{sensor.log_evidence:.1f}".replace("-", "\N{MINUS SIGN}"),
            "stands out" if sensor.stands_out else "",
        )
        for sensor in study.sensors
    ]
    columns = ("sensor", "presses", "level", "deviation", "p", "ln odds", "")
    yield text_table(_SENSORS, columns, rows, (1, 2, 3, 4, 5))
    yield Figure(
        _MAPS, f"Maps of the response of {plural(len(rows), 'sensor')} and the common one", partial(_draw, study)
    )


def _draw(study: BatchStudy) -> str:
    from cbsr_qa.studies.batch.figures import maps_figure  # the terminal needs no matplotlib

    maps = [("common", study.model.prior.predict(study.places_mm)[0], False)]
    for sensor, found in zip(study.sensors, study.maps, strict=True):
        maps.append((sensor.serial, found.predict(study.places_mm)[0], sensor.stands_out))
    return maps_figure(study.places_mm, maps, study.shape, study.model.loads.places_mm)


def _list_quantities(study: BatchStudy) -> Table:
    rows = [
        (
            quantity.name,
            str(quantity.sensors),
            _NONE if quantity.unit == "1" else _amount(quantity.mean, quantity.unit),
            _amount(quantity.deviation, quantity.unit),
            f"{_amount(quantity.drift, quantity.unit)} ({_amount(quantity.drift_low, quantity.unit)} to"
            f" {_amount(quantity.drift_high, quantity.unit)})",
            f"{quantity.drift_p:.2g}",
        )
        for quantity in study.quantities
    ]
    return text_table(_QUANTITIES, ("quantity", "sensors", "mean", "deviation", "drift", "p"), rows, (1, 2, 3, 4, 5))


def _list_expected(study: BatchStudy) -> Table:
    rows = [(str(expected.presses), f"{_percent(expected.error)} %") for expected in study.expected]
    return text_table(_EXPECTED, ("presses", "error"), rows, (0, 1))


def _amount(value: float, unit: str) -> str:
    if unit == "1":
        return f"{_percent(value, 2)} %"
    return f"{number(value)} {unit}"


def _percent(value: float, decimals: int = 1) -> str:
    return f"{100 * value:.{decimals}f}".replace("-", "\N{MINUS SIGN}")
