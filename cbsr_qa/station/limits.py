"""Limits of a station: all violations of a plan, and a SafetyError for the first one during a run."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np

from cbsr_qa.domain.errors import ConfigError, SafetyError
from cbsr_qa.domain.plan.standards import ROLE_UNITS, ReferenceStandard, StandardRole, find_standard
from cbsr_qa.domain.readings.frames import FrameBlock, ReadingFlag, SampleBlock
from cbsr_qa.domain.readings.loads import Load
from cbsr_qa.domain.sensor.patterns import find_shared_electrode
from cbsr_qa.plugin.instruments import Sampler
from cbsr_qa.station.bench import FORCE_CHANNEL
from cbsr_qa.station.plan import Plan, duration

#: Tolerance in comparing sums of durations: below the resolution of any clock after hours [s].
_ROUNDING_S: Final = 1e-6


@dataclass(frozen=True, slots=True)
class Violation:
    """A limit that a step would violate.

    Parameters
    ----------
    rule : ``"strain"``, ``"force"``, ``"travel"``, ``"dwell"``, ``"duration"``, ``"standard"`` or ``"order"``.
    """

    rule: str
    what: str


def place_violations(x_mm: float, y_mm: float, plan: Plan) -> Iterator[Violation]:
    """Yield violations of a place: it is out of the head's range, or the head is not entirely on the sheet."""
    radius_mm = math.hypot(x_mm, y_mm)
    if not radius_mm <= plan.safety.travel_radius_mm:
        yield Violation(
            "travel", f"{radius_mm:.4g} mm from the centre; the station allows {plan.safety.travel_radius_mm:g} mm"
        )
    stage = find_standard(plan.standards, StandardRole.STAGE)
    if stage is not None and not 2 * radius_mm <= stage.span:
        across = f"{radius_mm:.4g} mm from the centre, which takes a travel of {2 * radius_mm:.4g} mm"
        yield Violation("standard", _describe_range(stage, across))
    if plan.sensor_type.polygon is None:
        yield from _check_disc(radius_mm, plan)
    else:
        yield from _check_polygon(x_mm, y_mm, plan)


def _check_disc(radius_mm: float, plan: Plan) -> Iterator[Violation]:
    head_mm, sheet_mm = plan.indenter.reach_mm, plan.sensor_type.radius_mm
    if not radius_mm + head_mm <= sheet_mm:
        yield Violation(
            "travel",
            f"the head of {2 * head_mm:g} mm would reach {radius_mm + head_mm:.4g} mm; the sheet ends at"
            f" {sheet_mm:g} mm",
        )


def _check_polygon(x_mm: float, y_mm: float, plan: Plan) -> Iterator[Violation]:
    head_mm = plan.indenter.reach_mm
    room_mm = float(plan.sensor_type.outline.clearance_mm(np.array([[x_mm, y_mm]]))[0])
    if not room_mm >= head_mm and not _stands_on(x_mm, y_mm, plan):
        place = f"{room_mm:.4g} mm from the sheet's edge" if room_mm >= 0 else f"{-room_mm:.4g} mm outside the sheet"
        yield Violation(
            "travel", f"the head of {2 * head_mm:g} mm would stand {place}; it needs {head_mm:g} mm inside it"
        )


def _stands_on(x_mm: float, y_mm: float, plan: Plan) -> bool:
    """Whether the full outline of a polygonal head is on the sheet, edge included.

    A head may be as wide as a strip, and turned with it. The outline is sampled every 0.25 mm.
    """
    corners = np.array(plan.indenter.outline_mm)
    if not len(corners):
        return False
    next_corners = np.roll(corners, -1, axis=0)
    steps = [max(math.ceil(math.dist(a, b) / 0.25), 1) for a, b in zip(corners, next_corners, strict=True)]
    edges = [
        np.linspace(a, b, count, endpoint=False) for a, b, count in zip(corners, next_corners, steps, strict=True)
    ]
    clearance_mm = plan.sensor_type.outline.clearance_mm(np.vstack(edges) + np.array([x_mm, y_mm]))
    return bool((clearance_mm >= -1e-9).all())


def load_violations(load: Load, plan: Plan) -> Iterator[Violation]:
    """Yield violations of a load: its place, its strain, its expected force."""
    yield from place_violations(load.x_mm, load.y_mm, plan)
    yield from strain_violations(load.strain, plan)


def strain_violations(strain: float, plan: Plan) -> Iterator[Violation]:
    """Yield violations of a strain at any place: itself, and its expected force."""
    if not 0 < strain <= plan.safety.strain:
        yield Violation(
            "strain", f"{100 * strain:.4g} % strain; the station allows up to {100 * plan.safety.strain:g} %"
        )
    force_N = highest_force_N(strain, plan)
    if not force_N <= plan.safety.force_N:
        yield Violation("force", f"{force_N:.3g} N expected; the station allows {plan.safety.force_N:g} N")
    load_cell = find_standard(plan.standards, StandardRole.LOAD_CELL)
    relaxed_N = _predict_relaxed_force_N(strain, plan)
    if load_cell is not None and not load_cell.covers(relaxed_N):
        yield Violation("standard", _describe_range(load_cell, f"{relaxed_N:.3g} N expected once relaxed"))


def clearance_violations(clearance_mm: float, plan: Plan) -> Iterator[Violation]:
    """Yield violations of the height above the sheet at which the head is let travel."""
    lowest_mm, hover_mm = plan.motion.clearance_mm, plan.motion.hover_mm
    if not lowest_mm <= clearance_mm <= hover_mm:
        yield Violation(
            "travel",
            f"the head would travel {clearance_mm:g} mm above the sheet; the station allows {lowest_mm:g} to"
            f" {hover_mm:g} mm",
        )


def dwell_violations(dwell_s: float, plan: Plan) -> Iterator[Violation]:
    """Yield violations of the time the head has been down without lifting."""
    if not dwell_s <= plan.safety.dwell_s + _ROUNDING_S:
        allowed_s = plan.safety.dwell_s
        yield Violation("dwell", f"the head is down for {dwell_s:.4g} s; the station allows {allowed_s:g} s")


def highest_force_N(strain: float, plan: Plan) -> float:
    """Return the highest expected force of a press [N].

    E ε A is the relaxed force (E of the material file is the relaxed modulus); at the end of a fast ramp the relaxing
    terms add to it: F = E ε A (1 + Σ max(w, 0)), an upper bound for any mixture of signs.
    """
    overshoot = sum(max(weight, 0.0) for weight in plan.material.stress_relaxation.weights)
    return _predict_relaxed_force_N(strain, plan) * (1 + overshoot)


def _predict_relaxed_force_N(strain: float, plan: Plan) -> float:
    return plan.material.modulus_kPa.value * 1e-3 * strain * plan.indenter.area_mm2


def _describe_range(standard: ReferenceStandard, planned: str) -> str:
    """Return what is planned beside the range of a certificate, with the key that states it."""
    key = f"standards.{standard.role}.range_{ROLE_UNITS[standard.role]}"
    return (
        f"{planned}; certificate {standard.certificate} covers {standard.range_words()} ({key} of the station file)"
    )


#: Channel whose samples are compared with the temperature range, and their unit.
TEMPERATURE_CHANNEL: Final = "temperature"
TEMPERATURE_UNIT: Final = "°C"
#: Greatest age of a limited temperature: a room does not warm up faster, and thermometers are slow [s].
TEMPERATURE_STALE_S: Final = 300.0

_LIMITED: Final = int(ReadingFlag.COMPLIANCE | ReadingFlag.SATURATED)


def check_samplers(plan: Plan, samplers: tuple[Sampler, ...]) -> None:
    """Refuse a station that limits a temperature which no instrument measures.

    ConfigError naming the key, what was found and what is needed.
    """
    unit = {sampler.channel: sampler.unit for sampler in samplers}.get(TEMPERATURE_CHANNEL)
    if plan.safety.temperature_C is not None and unit != TEMPERATURE_UNIT:
        problem = "no instrument samples it" if unit is None else f"its unit is {unit!r}"
        raise ConfigError(
            f"[safety] temperature_C limits the temperature, but {problem}",
            remedy=f"add a thermometer that samples {TEMPERATURE_CHANNEL!r} in {TEMPERATURE_UNIT!r}, or drop the key",
        )


class Limits:
    """The station's limits, and the maximum age of measured values."""

    def __init__(self, plan: Plan, started_s: float) -> None:
        self._plan = plan
        self._started_s = started_s
        self._force_time_s = started_s
        self._temperature_time_s = started_s
        self._down_since_s: float | None = None
        usable = plan.sensor_type.pattern.usable()
        # On a strip with two pins every reading uses the driven pins, so that all count.
        self._counted = usable if usable.any() else np.ones_like(usable)

    def check_load(self, load: Load) -> None:
        _refuse(load_violations(load, self._plan))

    def check_place(self, x_mm: float, y_mm: float) -> None:
        _refuse(place_violations(x_mm, y_mm, self._plan))

    def check_samples(self, block: SampleBlock, who: str) -> None:
        """Check measured force and temperature against their limits, and record their age."""
        if len(block) and block.channel == FORCE_CHANNEL:
            self._check_force(block, who)
            self._force_time_s = max(self._force_time_s, float(block.time_s[-1]))
        elif len(block) and block.channel == TEMPERATURE_CHANNEL:
            self._check_temperature(block, who)
            self._temperature_time_s = max(self._temperature_time_s, float(block.time_s[-1]))

    def check_frame(self, block: FrameBlock, who: str) -> None:
        """Refuse frames with limited current or voltages: with an open lead they are not measurements."""
        limited = (block.flags & _LIMITED) != 0
        counted_limited = limited[:, self._counted]
        share = counted_limited.mean(axis=1)
        worst = int(share.argmax())
        if share[worst] >= self._plan.safety.compliance:
            suspect, drives = self._name_limited_drives(limited[worst])
            count = int(counted_limited[worst].sum())
            raise SafetyError(
                "compliance",
                f"{suspect}{count} of {counted_limited.shape[1]} readings of a frame of {who}"
                f" ({100 * share[worst]:.3g} %) were at the source's compliance or the end of the meter's range"
                f"{drives}; the station stops at {100 * self._plan.safety.compliance:g} %",
                remedy="check leads and contacts of these electrodes, and the drive current",
            )

    def check_time(self, now_s: float, *, touching: bool, down: bool) -> None:
        """Check the run's duration, how long the head has been down, and the age of samples.

        ``down``: whether the head is in the sheet, still or changing depth.
        """
        safety = self._plan.safety
        if now_s - self._started_s > safety.duration_s:
            raise SafetyError(
                "duration", f"the run takes longer than the station allows ({duration(safety.duration_s)})"
            )
        self._check_dwell(now_s, down)
        if touching:
            self._check_age("stale force", "force", now_s - self._force_time_s, safety.stale_s)
        if safety.temperature_C is not None:
            age_s = now_s - self._temperature_time_s
            self._check_age("stale temperature", "temperature", age_s, TEMPERATURE_STALE_S)

    def _check_dwell(self, now_s: float, down: bool) -> None:
        if not down:
            self._down_since_s = None
            return
        if self._down_since_s is None:
            self._down_since_s = now_s
        _refuse(dwell_violations(now_s - self._down_since_s, self._plan))

    def _check_force(self, block: SampleBlock, who: str) -> None:
        peak_N, allowed_N = float(abs(block.values).max()), self._plan.safety.force_N
        if not math.isfinite(peak_N):
            raise SafetyError(
                "force", f"the force of {who} is not a number", remedy="check the load cell and its cable"
            )
        if peak_N > allowed_N:
            raise SafetyError("force", f"{peak_N:.3g} N measured by {who}; the station allows {allowed_N:g} N")

    def _check_temperature(self, block: SampleBlock, who: str) -> None:
        allowed_C = self._plan.safety.temperature_C
        if allowed_C is None:
            return
        lowest_C, highest_C = allowed_C
        out_of_range_C = block.values[~((block.values >= lowest_C) & (block.values <= highest_C))]
        if len(out_of_range_C):
            raise SafetyError(
                "temperature",
                f"{out_of_range_C[0]:.4g} °C measured by {who}; the station allows {lowest_C:g} to {highest_C:g} °C",
            )

    def _name_limited_drives(self, limited: np.ndarray[tuple[int, ...], np.dtype[np.bool_]]) -> tuple[str, str]:
        """Name the electrode whose lead may be open, and the drive pairs whose counted readings were all limited.

        An open lead limits both of its pairs. A text is empty where nothing was limited as a whole.
        """
        limited_pairs = self._plan.sensor_type.pattern.list_silent_drives(limited, self._counted)
        if not limited_pairs:
            return "", ""
        drive_names = ", ".join(f"{source}–{sink}" for source, sink in limited_pairs[:6]) + (
            " …" if len(limited_pairs) > 6 else ""
        )
        electrode = find_shared_electrode(limited_pairs)
        suspect = "" if electrode is None else f"electrode {electrode} may be open: "
        return suspect, f", all of those driven through electrodes {drive_names}"

    @staticmethod
    def _check_age(rule: str, what: str, age_s: float, allowed_s: float) -> None:
        if age_s > allowed_s:
            while_touching = " while the head touches the sheet" if what == "force" else ""
            raise SafetyError(
                rule,
                f"the last {what} sample is {age_s:.3g} s old; the station allows {allowed_s:g} s{while_touching}",
                remedy="check the load cell and its cable" if what == "force" else "check the thermometer",
            )


def _refuse(violations: Iterator[Violation]) -> None:
    for violation in violations:
        raise SafetyError(violation.rule, violation.what)
