"""What became of a run with a fault in it: whether bench, record and readings are as they must be."""

import math
import threading
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from short_run import HELD_FRAMES, NINE_PLACES, UNLOADED_FRAMES, configuration

from cbsr_qa.domain.plan.steps import stroke_s
from cbsr_qa.domain.run.events import RunEnded
from cbsr_qa.domain.run.run import RunRecord
from cbsr_qa.domain.run.states import EndReason
from cbsr_qa.simulate.instruments.rig import EmulatedRig

Array = NDArray[np.float64]

#: How far readings of two runs may be from each other, in the noise expected of their difference.
MOST_NOISE = 1.5


@dataclass(slots=True)
class Outcome:
    """What became of a run.

    Parameters
    ----------
    kind : ``"rode through"``, ``"broken"`` or ``"broken, not safe"``.
    last_step : number of the step that was under way at the end.
    safe_after_s : station time from the moment it was told to stop until head and source were safe.
    wrong : in words, what must not be.
    """

    kind: str
    detail: str
    last_step: int
    safe_after_s: float
    wrong: list[str] = field(default_factory=list)


@dataclass(frozen=True, slots=True)
class Measured:
    """What a run measured.

    Parameters
    ----------
    unloaded : (m,) mean readings of the rested sheet [V].
    held : (loads, m) mean change of the readings in each hold [V].
    noise : root mean square over the readings of their standard deviation while resting [V].
    """

    unloaded: Array
    held: Array
    noise: float


def allowed_s() -> float:
    """How long coming to rest may take: a second to notice, and the head's travel up from its deepest."""
    return 1.0 + stroke_s(configuration(NINE_PLACES).station.motion, deepest_mm())


def deepest_mm() -> float:
    """How deep the station lets the head go."""
    here = configuration(NINE_PLACES)
    return here.station.safety.strain * here.sensor_type.thickness_mm


def is_up(rig: EmulatedRig) -> bool:
    """Whether the head hovers; one that has lost its position goes up by the hover height from where it is."""
    return rig.head.height_mm >= rig.motion.hover_mm - deepest_mm()


def came_to_rest_s(rig: EmulatedRig, clock: Any, limit_s: float) -> float | None:
    """When source and head were safe, on the station's clock; None if they were not by then.

    Commands that were sent without an answer may still be on their way in real time.
    """
    patience = threading.Event()
    for _ in range(20):
        if rig.wiring.current_A is None and (is_up(rig) or rig.head.moving):
            break
        patience.wait(0.05)
    while clock.now() < limit_s and not (is_up(rig) and rig.wiring.current_A is None):
        clock.sleep(0.05)
    return float(clock.now()) if is_up(rig) and rig.wiring.current_A is None else None


def bench_is_wrong(rig: EmulatedRig, ended: RunEnded, safe_after_s: float | None) -> list[str]:
    """What of the bench at the end must not be, in words."""
    wrong = []
    if safe_after_s is None and "NOT SAFE" not in ended.detail:
        source = "off" if rig.wiring.current_A is None else "ON"
        wrong.append(f"head {rig.head.height_mm:.1f} mm up, source {source}, and nobody is told")
    if safe_after_s is not None and "NOT SAFE" in ended.detail and ended.end is EndReason.FINISHED:
        wrong.append("finished, but not safe")
    if rig.head.dragged:
        wrong.append("the head was dragged through the sheet")
    return wrong


def record_is_wrong(record: RunRecord, ended: RunEnded, delivered: int) -> list[str]:
    """What of the stored record must not be, in words; ``delivered`` frames were told of."""
    wrong = []
    if record.end is not ended.end and "journal" not in ended.detail:
        wrong.append(f"the record says {record.end}, the runner {ended.end}")
    frames = [phase.frames for phase in record.phases if phase.frames is not None]
    stored = sum(len(block) for block in frames)
    if stored != delivered:
        wrong.append(f"{stored} frames stored, {delivered} delivered")
    if any((np.diff(block.time_s) <= 0).any() for block in frames):
        wrong.append("a frame is stored twice, or out of order")
    return wrong


def measured_otherwise(found: Measured, expected: Measured) -> list[str]:
    """What a run that rode through a fault measured must be what one without measures, within noise.

    A lost step of the multiplexer shifts readings by as much as they are: a thousand times the noise.
    """
    if found.held.shape != expected.held.shape:
        return [f"{len(found.held)} loads measured, {len(expected.held)} asked for"]
    wrong = []
    off = _rms(found.unloaded - expected.unloaded) / (expected.noise * math.sqrt(2 / UNLOADED_FRAMES))
    if off > MOST_NOISE:
        wrong.append(f"unloaded readings are {off:.1f} times the noise off")
    per_load = expected.noise * math.sqrt(2 / HELD_FRAMES + 2 / UNLOADED_FRAMES)
    for number, (change, other) in enumerate(zip(found.held, expected.held, strict=True)):
        off = _rms(change - other) / per_load
        if off > MOST_NOISE:
            wrong.append(f"load {number} is {off:.1f} times the noise off")
    return wrong


def _rms(values: Array) -> float:
    return float(np.sqrt((values**2).mean()))


def measured(record: RunRecord) -> Measured:
    """Read what a finished run measured, of the readings an image is made of."""
    (phase,) = record.phases
    assert phase.frames is not None
    assert phase.unloaded_from_s is not None
    usable = record.sensor_type.pattern.usable()
    first_s = phase.loads[0].press_start_s if phase.loads else math.inf
    resting = phase.frames.select_interval(phase.unloaded_from_s, first_s).voltages[:, usable]
    unloaded = resting.mean(axis=0)
    held = [
        phase.frames.select_interval(load.hold_start_s, load.release_start_s).voltages[:, usable]
        for load in phase.loads
    ]
    noise = float(np.sqrt(resting.var(axis=0, ddof=1).mean()))
    return Measured(unloaded, np.array([frames.mean(axis=0) - unloaded for frames in held]), noise)
