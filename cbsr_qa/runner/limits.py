"""The station's limits, held against what the bench says while steps are executed.

The dry run has checked what was planned; here is checked what happens. Every check raises
:class:`~cbsr_qa.domain.errors.SafetyError` naming its rule.
"""

import math
from collections.abc import Iterator
from typing import Final

import numpy as np

from cbsr_qa.domain.errors import ConfigError, SafetyError
from cbsr_qa.domain.frames import FrameBlock, ReadingFlag, SampleBlock
from cbsr_qa.domain.loads import Load
from cbsr_qa.interfaces import Sampler
from cbsr_qa.runner.bench import FORCE_CHANNEL
from cbsr_qa.runner.plan import Plan
from cbsr_qa.runner.rules import Violation, dwell_violations, load_violations, place_violations
from cbsr_qa.runner.wording import duration

#: Channel whose samples the range of temperatures is held against, and the unit they must have.
TEMPERATURE_CHANNEL: Final = "temperature"
TEMPERATURE_UNIT: Final = "°C"
#: A limited temperature may be this old: a room does not warm up faster, and thermometers are slow [s].
TEMPERATURE_STALE_S: Final = 300.0

_LIMITED: Final = int(ReadingFlag.COMPLIANCE | ReadingFlag.SATURATED)


def check_samplers(plan: Plan, samplers: tuple[Sampler, ...]) -> None:
    """Refuse a station that limits a temperature which nothing measures.

    Raises
    ------
    ConfigError
        Naming the key, what was found and what is needed.
    """
    unit = {one.channel: one.unit for one in samplers}.get(TEMPERATURE_CHANNEL)
    if plan.safety.temperature_C is not None and unit != TEMPERATURE_UNIT:
        found = "no instrument samples it" if unit is None else f"it is sampled in {unit!r}"
        raise ConfigError(
            f"[safety] temperature_C limits the temperature, but {found}",
            remedy=f"add a thermometer that samples {TEMPERATURE_CHANNEL!r} in {TEMPERATURE_UNIT!r}, or leave the key"
            " out",
        )


class Limits:
    """What the station allows, and how fresh what is known is.

    Parameters
    ----------
    plan : with the station's limits.
    started_s : on the run's clock.
    """

    def __init__(self, plan: Plan, started_s: float) -> None:
        self._plan = plan
        self._started_s = started_s
        self._force_time_s = started_s
        self._temperature_time_s = started_s
        self._down_since_s: float | None = None
        usable = plan.sensor_type.pattern.usable()
        # On a strip with two pins every reading touches the driven ones, and counts.
        self._counted = usable if usable.any() else np.ones_like(usable)

    def check_load(self, load: Load) -> None:
        """Check strain, expected force and place of a press before it."""
        _refuse(load_violations(load, self._plan))

    def check_place(self, x_mm: float, y_mm: float) -> None:
        """Check a place before the head goes there."""
        _refuse(place_violations(x_mm, y_mm, self._plan))

    def check_samples(self, block: SampleBlock, who: str) -> None:
        """Hold measured force and temperature against their limits, and remember how fresh they are.

        Parameters
        ----------
        who : the instrument that sampled.
        """
        if len(block) and block.channel == FORCE_CHANNEL:
            self._check_force(block, who)
            self._force_time_s = max(self._force_time_s, float(block.time_s[-1]))
        elif len(block) and block.channel == TEMPERATURE_CHANNEL:
            self._check_temperature(block, who)
            self._temperature_time_s = max(self._temperature_time_s, float(block.time_s[-1]))

    def check_frame(self, block: FrameBlock, who: str) -> None:
        """Refuse frames whose current or voltages were limited: with an open lead they are no measurement."""
        limited = (block.flags & _LIMITED) != 0
        counted = limited[:, self._counted]
        share = counted.mean(axis=1)
        worst = int(share.argmax())
        if share[worst] >= self._plan.safety.compliance:
            drives = self._limited_drives(limited[worst])
            raise SafetyError(
                "compliance",
                f"{int(counted[worst].sum())} of {counted.shape[1]} readings of a frame of {who}"
                f" ({100 * share[worst]:.3g} %) were at the source's compliance or the end of the meter's range"
                f"{drives}; the station stops at {100 * self._plan.safety.compliance:g} %",
                remedy="check leads and contacts of these electrodes, and the drive current",
            )

    def check_time(self, now_s: float, *, touching: bool, down: bool) -> None:
        """Check the run's duration, how long the head has been down, and the age of what must be fresh.

        Parameters
        ----------
        touching : whether the head touches, or may touch, the sheet.
        down : whether it is in the sheet, and still or eased.
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
        outside = block.values[~((block.values >= lowest_C) & (block.values <= highest_C))]
        if len(outside):
            raise SafetyError(
                "temperature",
                f"{outside[0]:.4g} °C measured by {who}; the station allows {lowest_C:g} to {highest_C:g} °C",
            )

    def _limited_drives(self, limited: np.ndarray[tuple[int, ...], np.dtype[np.bool_]]) -> str:
        """Name the drive pairs of which every counted reading was limited: an open lead limits both of its own."""
        pairs = zip(self._plan.sensor_type.pattern.drive, limited, self._counted, strict=True)
        whole = [pair for pair, row, counted in pairs if counted.any() and row[counted].all()]
        if not whole:
            return ""
        named = ", ".join(f"{source}–{sink}" for source, sink in whole[:6]) + (" …" if len(whole) > 6 else "")
        shared = set.intersection(*(set(pair) for pair in whole)) if len(whole) > 1 else set()
        suspect = f": electrode {shared.pop()} may be open" if len(shared) == 1 else ""
        return f", all of those driven through electrodes {named}{suspect}"

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
