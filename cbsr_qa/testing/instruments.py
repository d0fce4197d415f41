"""Conformance of instrument drivers: what the runner relies on for any instrument.

Each check takes an instrument that is open and linked. Over an emulated or simulated one it takes station time and
hardly any of ours; on a real bench :func:`check_applicator` moves the head, and presses.
"""

import math
import threading
from collections.abc import Callable
from functools import partial
from typing import Final

import numpy as np

from cbsr_qa.domain.errors import InstrumentError
from cbsr_qa.domain.plan import steps as kinematics
from cbsr_qa.domain.plan.plan import Motion
from cbsr_qa.domain.readings.frames import FrameBlock, SampleBlock, VoltageUnit, join_frames
from cbsr_qa.domain.run.run import InstrumentIdentity
from cbsr_qa.domain.sensor.sensor_type import SensorType
from cbsr_qa.plugin.instruments import ForceApplicator, FrameSource, GuidedApplicator, Instrument, Sampler
from cbsr_qa.system.clock import Clock, RealClock
from cbsr_qa.testing.checked import Checked, demand, describe_failure

#: Safe states are reached within this time, besides the head's travel [s, real time].
SAFE_WITHIN_S: Final = 1.0
#: Times may differ by this much of a frame period or of a sample's age: transmission and clock ticks.
_SLACK: Final = 0.15
_TICK_S: Final = 1e-3


def check_instrument(instrument: Instrument, role: type) -> list[Checked]:
    """Check what any instrument promises: its role's methods, who it is, a safe state from any thread, twice."""
    demand(instrument, isinstance(instrument, role), f"is no {role.__name__}: it lacks a method or property")
    identity = instrument.identity()
    known = isinstance(identity, InstrumentIdentity)
    demand(instrument, known, f"says it is {identity!r}, which is no InstrumentIdentity")
    demand(instrument, bool(identity.model.strip()), "says of itself no model, under which a record could name it")
    demand(instrument, instrument.identity() == identity, "says something else each time it is asked who it is")
    took_s = max(safe_state_s(instrument) for _ in range(2))
    return [
        Checked("identity", f"{identity.driver}: {identity.model}"),
        Checked("safe state", f"reached twice, from another thread, within {took_s:.2g} s"),
    ]


def check_frame_source(source: FrameSource, clock: Clock, sensor_type: SensorType) -> tuple[Checked, ...]:
    """Check a frame source: shape, unit and times of its frames, and that none is older than the request.

    Remedy: give each frame the middle of its own time on the context's clock, and drop frames that began before
    the request.

    Parameters
    ----------
    clock, sensor_type : those the source was opened with.
    """
    done = check_instrument(source, FrameSource)
    period_s = source.frame_period_s
    demand(source, math.isfinite(period_s) and period_s > 0, f"says that a frame takes {period_s!r} s")
    blocks = [_frames(source, clock, count, sensor_type) for count in (1, 2, 1)]
    clock.sleep(2.3 * period_s)
    blocks.append(_frames(source, clock, 1, sensor_type))
    safe_state_s(source)
    blocks.append(_frames(source, clock, 1, sensor_type))  # runs begin with a safe state
    whole = join_frames(blocks)
    gaps_s = np.diff(whole.time_s)
    demand(source, bool((gaps_s > (0.5 - _SLACK) * period_s).all()), f"gives frames {gaps_s.min():.3g} s apart")
    for count in (0, -1):
        _refuses(source, partial(source.acquire, count), f"{count} frames")
    unit = "counts" if whole.unit is VoltageUnit.COUNT else "volts"
    done.append(
        Checked("frames", f"{len(whole)} frames of {period_s:.3g} s in {unit}, at least {gaps_s.min():.3g} s apart")
    )
    return tuple(done)


def check_sampler(
    sampler: Sampler, clock: Clock, *, within_s: float = 2.0, wait: Callable[[], object] | None = None
) -> tuple[Checked, ...]:
    """Check a sampler: samples arrive in order, for the requested time, without repetition.

    Remedy: return samples after the given time only, in order of time, stamped on the context's clock.

    Parameters
    ----------
    clock : the one the sampler was opened with.
    within_s : how old its last sample may be; a station's ``stale_s`` stops runs whose force is older.
    wait : lets samples fall due; by default so much time passes on the clock.
    """
    done = check_instrument(sampler, Sampler)
    channel, unit = sampler.channel, sampler.unit
    demand(sampler, bool(channel and unit), f"samples channel {channel!r} in {unit!r}: both must say something")
    start_s = clock.now()
    blocks: list[SampleBlock] = []
    for _ in range(4):
        clock.sleep(within_s) if wait is None else wait()
        last_s = blocks[-1].time_s[-1] if blocks else start_s
        blocks.append(_samples(sampler, clock, float(last_s)))
        age_s = clock.now() - float(blocks[-1].time_s[-1])
        demand(sampler, age_s <= within_s, f"has a last sample that is {age_s:.3g} s old")
    again = _samples(sampler, clock, start_s)
    together = sum(len(block) for block in blocks)
    # A driver may forget what it has handed out; what it still has it gives unchanged.
    kept = np.isin(np.concatenate([block.time_s for block in blocks]), again.time_s)
    demand(sampler, len(again) <= together + 1, f"gives {len(again)} samples where {together} came one after another")
    counted = (
        f"{together} of {channel} in {unit} within {clock.now() - start_s:.3g} s, {int(kept.sum())} of them kept"
    )
    done.append(Checked("samples", counted))
    return tuple(done)


def check_applicator(
    head: ForceApplicator,
    clock: Clock,
    motion: Motion,
    *,
    depth_mm: float = 0.4,
    places: tuple[tuple[float, float], tuple[float, float]] = ((0.0, 0.0), (10.0, 5.0)),
    depth_now_mm: Callable[[], float] | None = None,
) -> tuple[Checked, ...]:
    """Check a force applicator: it takes the expected time, moves directly, and comes up on every request.

    Remedy: follow the station's ``motion``, lift before each travel, and come up in ``safe_state``.

    Parameters
    ----------
    clock, motion : those the applicator was opened with.
    depth_mm : how deep it presses; twice as deep it eases.
    places : from the sheet's centre; the surface is found at the first.
    depth_now_mm : independent depth of the head below the surface, negative above it: an emulated world, a gauge.
        Without it only the time is looked at, and the time a movement takes.
    """
    done = check_instrument(head, ForceApplicator)
    seen = _Seen(head, depth_now_mm, motion)
    head.home()
    seen.up("homing")
    surface_mm = head.find_surface(*places[0])
    seen.up("finding the surface")
    near = 0.5 * motion.hover_mm < surface_mm < 1.5 * motion.hover_mm
    demand(head, near, f"finds the surface {surface_mm!r} mm below a hover height of {motion.hover_mm:g} mm")
    done.append(Checked("surface", f"{surface_mm:.4g} mm below the hover height"))
    done.append(_check_strokes(head, clock, motion, depth_mm, seen))
    if isinstance(head, GuidedApplicator):
        done.append(_check_guided(head, motion, surface_mm, depth_mm, places[1], seen))
    head.press(depth_mm, motion.press_speed_mm_s)
    head.move_to(*places[1])  # a head that is down is lifted, not dragged
    seen.up("travelling")
    head.release()
    head.release()
    seen.up("being released twice")
    done.append(_check_safe_head(head, clock, motion, depth_mm, seen))
    return tuple(done)


def check_closing(instrument: Instrument, use: Callable[[], object]) -> Checked:
    """Check that an instrument can be closed twice, and that using it then is at worst an InstrumentError.

    Remedy: let ``close`` be called twice, and raise ``InstrumentError`` when the link is used afterwards.

    Parameters
    ----------
    use : uses it, e.g. ``lambda: source.acquire(1)``.
    """
    instrument.close()
    instrument.close()
    try:
        use()
    except InstrumentError as error:
        return Checked("closing", f"then: {error.reason}")
    except Exception as error:
        raise AssertionError(
            describe_failure(instrument, f"raises {type(error).__name__} when it is used closed")
        ) from error
    return Checked("closing", "twice; it can still be used")


class _Seen:
    """Looks where the head is, if anybody can say."""

    def __init__(self, head: ForceApplicator, depth_now_mm: Callable[[], float] | None, motion: Motion) -> None:
        self._head, self._depth_now_mm, self._hover_mm = head, depth_now_mm, motion.hover_mm

    def up(self, after: str) -> None:
        if self._depth_now_mm is not None:
            height_mm = -self._depth_now_mm()
            demand(
                self._head, height_mm > 0.9 * self._hover_mm, f"is {height_mm:.3g} mm above the sheet after {after}"
            )

    def demand_height(self, height_mm: float, after: str) -> None:
        """Demand that it is at a height above the sheet, to half a millimetre."""
        if self._depth_now_mm is not None:
            found_mm = -self._depth_now_mm()
            near = abs(found_mm - height_mm) <= 0.5
            demand(self._head, near, f"is {found_mm:.3g} mm above the sheet after {after}, not {height_mm:.3g} mm")

    def demand_depth(self, depth_mm: float) -> None:
        """Demand that it is at a depth, to a tenth of a millimetre: surfaces are found to about that."""
        if self._depth_now_mm is not None:
            found_mm = self._depth_now_mm()
            demand(
                self._head,
                abs(found_mm - depth_mm) <= 0.1,
                f"is {found_mm:.3g} mm deep when told to press {depth_mm:g} mm",
            )


def _check_strokes(head: ForceApplicator, clock: Clock, motion: Motion, depth_mm: float, seen: _Seen) -> Checked:
    """Down, deeper, back and up: each in the time it takes, and in the sheet without leaving it."""
    speed = motion.press_speed_mm_s
    took_s = []
    for depth in (depth_mm, 2 * depth_mm, depth_mm):
        before_s = clock.now()
        head.press(depth, speed)
        took_s.append(clock.now() - before_s)
        seen.demand_depth(depth)
    before_s = clock.now()
    head.release()
    took_s.append(clock.now() - before_s)
    seen.up("being released")
    ease_s = kinematics.ease_s(motion, depth_mm, 2 * depth_mm)
    down_s = kinematics.ease_s(motion, 0.0, depth_mm)
    demand(head, took_s[0] >= 0.9 * down_s, f"presses {depth_mm:g} mm in {took_s[0]:.3g} s at {speed:.3g} mm/s")
    for eased_s in took_s[1:3]:
        right = 0.9 * ease_s <= eased_s < kinematics.stroke_s(motion, 0.0)
        demand(
            head, right, f"takes {eased_s:.3g} s to ease {depth_mm:g} mm at {speed:.3g} mm/s: that is {ease_s:.3g} s"
        )
    demand(head, took_s[3] > 0, "comes up in no time")
    return Checked(
        "strokes", f"down {took_s[0]:.3g} s, eased {took_s[1]:.3g} and {took_s[2]:.3g} s, up {took_s[3]:.3g} s"
    )


#: How much lower than found a surface is said to be, and how low the head is then told to travel [mm].
_LOWER_MM: Final = 0.3
_CLEARANCE_MM: Final = 3.0


def _check_guided(
    head: GuidedApplicator,
    motion: Motion,
    surface_mm: float,
    depth_mm: float,
    place_mm: tuple[float, float],
    seen: _Seen,
) -> Checked:
    """Presses from the surface that it is told, and travels as low as it is told until it homes."""
    head.lower_hover(surface_mm - _CLEARANCE_MM)
    head.expect_surface(*place_mm, surface_mm + _LOWER_MM)
    head.move_to(*place_mm)
    head.press(depth_mm, motion.press_speed_mm_s)
    seen.demand_depth(depth_mm + _LOWER_MM)
    head.release()
    seen.demand_height(_CLEARANCE_MM, "being released to a lowered hover height")
    safe_state_s(head)
    head.home()
    seen.up("homing from a lowered hover height")
    head.move_to(0.0, 0.0)
    return Checked(
        "guided", f"pressed from a surface it was told, and travelled {_CLEARANCE_MM:g} mm above the sheet"
    )


def _check_safe_head(head: ForceApplicator, clock: Clock, motion: Motion, depth_mm: float, seen: _Seen) -> Checked:
    """A head that is down comes up when made safe, and moves again on command."""
    head.press(depth_mm, motion.press_speed_mm_s)
    took_s = safe_state_s(head)
    clock.sleep(2 * kinematics.stroke_s(motion, depth_mm))
    seen.up("being made safe while it was down")
    head.home()
    head.move_to(0.0, 0.0)
    head.press(depth_mm, motion.press_speed_mm_s)
    head.release()
    seen.up("being used again")
    return Checked("safe while down", f"told within {took_s:.2g} s, and used again after homing")


def _frames(source: FrameSource, clock: Clock, count: int, sensor_type: SensorType) -> FrameBlock:
    """Take frames, and hold them against what a block of frames is."""
    before_s, period_s = clock.now(), source.frame_period_s
    block = source.acquire(count)
    now_s = clock.now()
    expected = (count, *sensor_type.pattern.shape)
    demand(source, block.voltages.shape == expected, f"gives frames of shape {block.voltages.shape}, not {expected}")
    demand(
        source, now_s > before_s, f"takes {count} frames in no time on the station's clock: a hold would never end"
    )
    middle = bool((block.time_s > before_s).all() and (block.time_s < now_s).all())
    demand(source, middle, f"gives frames of {block.time_s[0]:.6g} s to a call from {before_s:.6g} to {now_s:.6g} s")
    early_s = before_s - (block.time_s[0] - period_s / 2)
    demand(
        source, early_s <= (0.5 + _SLACK) * period_s, f"gives a frame that began {early_s:.3g} s before it was asked"
    )
    if block.reading_time_s is not None:
        off_s = np.abs(block.reading_time_s - block.time_s[:, None, None]).max()
        demand(
            source, off_s <= (0.5 + _SLACK) * period_s, f"has readings {off_s:.3g} s from the middle of their frame"
        )
    return block


def _samples(sampler: Sampler, clock: Clock, since_s: float) -> SampleBlock:
    """Take samples, and compare them with the request."""
    block = sampler.samples_since(since_s)
    named = (block.channel, block.unit) == (sampler.channel, sampler.unit)
    demand(sampler, named, f"gives {block.channel!r} in {block.unit!r}, which is not what it says it samples")
    demand(sampler, len(block) > 0, f"has no sample after {since_s:.6g} s at {clock.now():.6g} s")
    demand(sampler, bool((np.diff(block.time_s) > 0).all()), "gives samples that are not in the order of their times")
    first_s, last_s = float(block.time_s[0]), float(block.time_s[-1])
    demand(
        sampler, first_s > since_s, f"gives a sample of {first_s:.6g} s when asked for those after {since_s:.6g} s"
    )
    demand(sampler, last_s <= clock.now() + _TICK_S, f"gives a sample of {last_s:.6g} s at {clock.now():.6g} s")
    demand(sampler, bool(np.isfinite(block.values).all()), "gives a sample that is not a finite number")
    return block


def safe_state_s(instrument: Instrument) -> float:
    """Make it safe from another thread, as the runner does; return how long that took [s]."""
    raised: list[BaseException] = []

    def make_safe() -> None:
        try:
            instrument.safe_state()
        except BaseException as error:  # noqa: BLE001 - told to whoever waits
            raised.append(error)

    clock = RealClock()
    before_s = clock.now()
    thread = threading.Thread(target=make_safe, daemon=True)
    thread.start()
    thread.join(timeout=SAFE_WITHIN_S)
    took_s = clock.now() - before_s
    demand(instrument, not thread.is_alive(), f"is not safe within {SAFE_WITHIN_S:g} s")
    if raised:
        raise AssertionError(describe_failure(instrument, f"does not reach its safe state: {raised[0]}")) from raised[
            0
        ]
    return took_s


def _refuses(instrument: Instrument, call: Callable[[], object], what: str) -> None:
    try:
        call()
    except InstrumentError:
        return
    except Exception as error:
        raise AssertionError(describe_failure(instrument, f"raises {type(error).__name__} for {what}")) from error
    raise AssertionError(describe_failure(instrument, f"takes {what} without a word"))
