"""The checks of each kind of plugin, on example data."""

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

import numpy as np

from cbsr_qa.config.loader import load_material, load_scene, load_sensor_type, load_station
from cbsr_qa.domain.plan.plan import PluginChoice
from cbsr_qa.domain.results.report import Banner, Page, Section
from cbsr_qa.plugin import (
    CbsrError,
    Example,
    ForceApplicator,
    FrameSource,
    Kind,
    Linked,
    Multiplexer,
    ReadOptions,
    Recording,
    Sampler,
    SelfTesting,
    SequenceContext,
    SourceMeter,
    StationContext,
)
from cbsr_qa.plugin.discovery import Factory, Plugins
from cbsr_qa.report.render import render_sections
from cbsr_qa.simulate.world import SimulatedWorld
from cbsr_qa.station.dry_runs import dry_run
from cbsr_qa.station.plan import PlannedPhase
from cbsr_qa.system.clock import VirtualClock
from cbsr_qa.system.foreign import LARGEST_FILE, read_foreign
from cbsr_qa.testing.bench import example_plan
from cbsr_qa.testing.checked import Checked, Tolerances
from cbsr_qa.testing.instruments import (
    check_applicator,
    check_closing,
    check_frame_source,
    check_sampler,
)
from cbsr_qa.testing.kit.example_run import example_result
from cbsr_qa.testing.numerics import check_metric
from cbsr_qa.testing.reconstructions import reconstruction_checks
from cbsr_qa.testing.scanning import check_multiplexer, check_self_test, check_source_meter
from cbsr_qa.testing.sinks import check_sink

_SEED: Final = 1
_PERIOD_S: Final = 2.5


@dataclass(frozen=True, slots=True)
class Subject:
    """The plugin that is checked."""

    plugins: Plugins
    kind: Kind
    name: str
    factory: Factory
    example: Example

    def create(self) -> Any:
        return self.factory(**self.example.options)


Check = Callable[[], Checked | tuple[Checked, ...]]
Checks = Iterable[Check]


def _metric(subject: Subject) -> Checks:
    metric, observation = subject.create(), example_result().observation
    yield partial(check_measurements, metric, observation)
    yield partial(check_repeated_measurements, metric, observation)


def check_measurements(metric: Any, observation: Any) -> Checked:
    """Measurements of an example run can be stored, and have a name and unit of `measures`.

    Remedy: declare every measurement in ``measures`` with its unit; where a value cannot be determined, return a
    ``Measurement`` with None and ``how``.
    """
    taken = check_metric(metric, observation)
    values = ", ".join(
        f"{each.name} {'not measured' if each.value is None else f'{each.value:.4g} {each.unit}'}"
        for each in taken[:3]
    )
    return Checked("measurements", values + (f" and {len(taken) - 3} more" if len(taken) > 3 else "") or "none")


def check_repeated_measurements(metric: Any, observation: Any) -> Checked:
    """The same run gives the same measurements again.

    Remedy: keep no state between calls, draw no random numbers, and do not change the run.
    """
    assert check_metric(metric, observation) == check_metric(metric, observation), "other values the second time"
    return Checked("repeated measurements", "the same")


def _instrument(subject: Subject) -> Checks:
    station, clock = load_station("simulated").value, VirtualClock()
    context = StationContext(
        role=subject.name, clock=clock, sensor_type=load_sensor_type(station.sensor_type).value,
        material=load_material(station.material).value, indenter=station.indenter, seed=_SEED,
        options=dict(subject.example.options), scene=load_scene("base").value,
        effect_factory=partial(subject.plugins.factory, Kind.EFFECT), motion=station.motion, safety=station.safety,
    )  # fmt: skip
    instrument = subject.factory(context)
    yield partial(check_roles, instrument)
    if isinstance(instrument, Linked):
        instrument.close()
        return
    uses: list[Callable[[], object]] = [instrument.identity]
    if isinstance(instrument, FrameSource):
        yield partial(check_frame_source, instrument, clock, context.sensor_type)
        uses.append(partial(instrument.acquire, 1))
    if isinstance(instrument, Sampler):
        yield partial(check_sampler, instrument, clock)
        uses.append(partial(instrument.samples_since, 0.0))
    if isinstance(instrument, SourceMeter):
        yield partial(check_source_meter, instrument, clock)
        uses.append(instrument.measure)
    if isinstance(instrument, Multiplexer):
        yield partial(check_multiplexer, instrument, context.sensor_type.pattern)
        uses.append(instrument.start)
    if isinstance(instrument, ForceApplicator):
        yield partial(check_applicator, instrument, clock, station.motion)
        uses.append(instrument.home)
    if isinstance(instrument, SelfTesting):
        yield partial(check_self_test, instrument)
    yield partial(check_closing, instrument, uses[-1])


def check_roles(instrument: Any) -> Checked:
    """An instrument has the methods of at least one role of cbsr_qa.plugin.

    Remedy: add the missing methods of its role; the page "Write a driver" of the documentation lists them.
    """
    if isinstance(instrument, Linked):
        why = 'it is linked to other instruments; check it beside them, as the page "Write a driver" does'
        return Checked("roles", why, applies=False)
    roles = (FrameSource, Sampler, SourceMeter, Multiplexer, ForceApplicator)
    provided = [role.__name__ for role in roles if isinstance(instrument, role)]
    assert provided, f"{type(instrument).__name__} has the methods of no role"
    return Checked("roles", ", ".join(provided))


def _sequence(subject: Subject) -> Checks:
    sequence = subject.create()
    yield partial(check_same_steps, sequence)
    yield partial(check_dry_run, subject.name, sequence)


def check_same_steps(sequence: Any) -> Checked:
    """A sequence yields the same steps on every call.

    Remedy: keep no state between calls, and draw random numbers from the seed of the context.
    """
    plan = example_plan(seed=_SEED)
    context = SequenceContext(plan.sensor_type, plan.indenter, _SEED, plan.material)
    first, again = (list(islice(sequence.steps(context), 100_000)) for _ in range(2))
    assert first == again, "other steps the second time"
    return Checked("same steps", f"{len(first)} steps, twice the same")


def check_dry_run(name: str, sequence: Any) -> Checked:
    """The shipped simulated station allows the steps.

    Remedy: stay within the station's limits, with a number of steps that is neither 0 nor endless.
    """
    walked = dry_run(example_plan(PlannedPhase("example", name, sequence), seed=_SEED), _PERIOD_S)
    assert not walked.violations, "; ".join(walked.violations)
    return Checked("dry run", f"{walked.loads} loads, {walked.frames} frames, {walked.duration_s:.0f} s")


def check_scene(subject: Subject) -> Checked:
    """A scene with the effect can be simulated; readings are finite, and the same again for the same seed.

    Remedy: set ``perturbs`` and have the method of that stage; draw random numbers from ``RandomStream``, addressed
    with ``moment.index``.
    """
    base, choice = load_scene("base").value, PluginChoice(subject.name, dict(subject.example.options))
    others = tuple(effect for effect in base.effects if effect.name != subject.name)
    scene, station = replace(base, effects=(*others, choice)), load_station("simulated").value

    def simulate() -> tuple[Any, ...]:
        world = SimulatedWorld(
            scene, load_sensor_type(station.sensor_type).value, load_material(station.material).value,
            station.indenter, seed=_SEED, effect_factory=partial(subject.plugins.factory, Kind.EFFECT),
        )  # fmt: skip
        times_s = _PERIOD_S * np.arange(4, dtype=np.float64) + 1.0
        transcript = world.transcript(times_s)
        return [world.frame(float(t), n).voltages for n, t in enumerate(times_s)], transcript.lost

    (voltages, lost), (voltages_again, lost_again) = simulate(), simulate()
    assert np.isfinite(voltages).all(), "readings that are not finite"
    same = np.array_equal(voltages, voltages_again) and np.array_equal(lost, lost_again)
    assert same, "other readings the second time, for the same seed"
    return Checked("scene", f"{len(voltages)} frames, largest reading {np.abs(voltages).max():.4g} V")


def _recording(subject: Subject) -> Checks:
    format_, path = subject.create(), subject.example.file
    yield partial(check_recognition, format_, path)
    if path is not None:
        yield partial(check_reading, format_, path)
        yield partial(check_damaged_file, format_, path)


def check_recognition(format_: Any, path: Path | None) -> Checked:
    """A format recognises its example file, and nothing in an empty one or in random bytes.

    Remedy: give a file as ``file`` of the ``Example``; look at the first bytes for what only this format has.
    """
    assert path is not None, "no example file"
    head = read_foreign(path, LARGEST_FILE)[:4096]
    assert format_.recognises(path, head), f"{path.name} is not recognised"
    noise = np.random.default_rng(_SEED).bytes(4096)
    for what, other in (("an empty file", b""), ("random bytes", noise)):
        assert not format_.recognises(Path("other"), other), f"{what} are taken for this format"
    return Checked("recognition", path.name)


def check_reading(format_: Any, path: Path) -> Checked:
    """The example file is read whole, twice the same.

    Remedy: return a ``Recording`` whose frames hold every whole frame of the file.
    """
    first, again = (format_.read(path, ReadOptions()) for _ in range(2))
    assert isinstance(first, Recording), f"{type(first).__name__}, which is no Recording"
    assert np.array_equal(first.frames.voltages, again.frames.voltages), "other readings the second time"
    assert len(first.frames), "no frame"
    return Checked("reading", f"{len(first.frames)} frames of shape {first.frames.voltages.shape[1:]}")


def check_damaged_file(format_: Any, path: Path) -> Checked:
    """A file that ends too early, or is full of something else, is read in part or refused by a RecordingError.

    Remedy: catch errors of parsing, and raise ``RecordingError`` naming the line and what was expected.
    """
    whole, ends = read_foreign(path, LARGEST_FILE), []
    damaged = {
        "half": whole[: len(whole) // 2],
        "empty": b"",
        "noise": np.random.default_rng(_SEED).bytes(len(whole)),
    }
    with TemporaryDirectory() as folder:
        for name, content in damaged.items():
            file = Path(folder) / f"{name}{path.suffix}"
            file.write_bytes(content)
            try:
                format_.read(file, ReadOptions())
            except CbsrError:
                ends.append(f"{name} refused")
            except Exception as error:
                raise AssertionError(f"{type(error).__name__} for a file that is {name}: {error}") from error
            else:
                assert name == "half", f"a recording from a file that is {name}"
                ends.append(f"{name} read in part")
    return Checked("damaged file", ", ".join(ends))


def check_rendering(section: Any) -> Checked:
    """A section of an example run is a `Section` with a title that can be rendered, or None.

    Remedy: return ``Section(title, blocks)`` with blocks of ``cbsr_qa.domain.results``, or None.
    """
    rendered = section.render(example_result())
    if rendered is None:
        return Checked("rendering", "it has nothing to say about the example run", applies=False)
    assert isinstance(rendered, Section), f"{type(rendered).__name__}, which is no Section"
    assert rendered.title.strip(), "a section without a title"
    html = render_sections(Page("", "", Banner("plain", "", "", ""), ()), (rendered,))
    return Checked("rendering", f"{rendered.title!r} with {len(rendered.blocks)} blocks, {len(html)} characters")


def check_delivery(sink: Any, example: Example) -> Checked:
    """A sink delivers all messages in their order, and can be closed twice.

    Remedy: give ``received`` in the ``Example``; return from ``deliver`` only when the messages are taken.
    """
    assert example.received is not None, "no `received`, so what arrived is unknown"
    before = len(example.received())
    check_sink(sink, lambda: example.received()[before:] if example.received else [])
    assert math.isfinite(sink.largest_batch), "no largest batch"
    return Checked("delivery", f"{len(example.received()) - before} messages in order")


CHECKS_OF: Final[Mapping[Kind, Callable[[Subject], Checks]]] = {
    Kind.INSTRUMENT: _instrument,
    Kind.SEQUENCE: _sequence,
    Kind.RECONSTRUCTION: lambda subject: reconstruction_checks(
        partial(subject.factory, **subject.example.options), tolerances=Tolerances(**subject.example.tolerances)
    ),
    Kind.METRIC: _metric,
    Kind.EFFECT: lambda subject: [partial(check_scene, subject)],
    Kind.RECORDING: _recording,
    Kind.SECTION: lambda subject: [partial(check_rendering, subject.create())],
    Kind.SINK: lambda subject: [partial(check_delivery, subject.create(), subject.example)],
}
