"""Plan, clock and bench from configuration files."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cbsr_qa.config.loader import load_material, load_recipe, load_scene, load_sensor_type, load_station
from cbsr_qa.config.merging import Configuration, merge
from cbsr_qa.domain.errors import ConfigError, PluginError
from cbsr_qa.domain.plan.plan import InstrumentSpec, PluginChoice
from cbsr_qa.domain.readings.frames import Recording
from cbsr_qa.domain.run.run import InstrumentIdentity
from cbsr_qa.plugin.creation import create_plugin
from cbsr_qa.plugin.discovery import Plugins
from cbsr_qa.plugin.failures import blame_plugin
from cbsr_qa.plugin.hooks import Kind
from cbsr_qa.plugin.instruments import Instrument, StationContext
from cbsr_qa.simulate.world import SimulatedWorld
from cbsr_qa.station.bench import Action, Bench, open_bench
from cbsr_qa.station.plan import Plan, PlannedPhase
from cbsr_qa.system.clock import Clock, RealClock, VirtualClock

if TYPE_CHECKING:
    from cbsr_qa.simulate.instruments.rig import Emulation


def configure(
    station: str,
    recipe: str,
    *,
    sensor_type: str | None,
    material: str | None,
    seed: int,
    plugins: Plugins | None = None,
    unfinished: bool = False,
) -> Configuration:
    """Load and merge the files of a run.

    ConfigError if a file is missing or wrong.

    Parameters
    ----------
    sensor_type, material : files or names that replace the station's own; those are looked for next to its file
        first.
    plugins : installed plugins, to check their options in the same pass; None checks no options.
    unfinished : whether the station may lack instruments that every run needs.
    """
    loaded_station = load_station(station, plugins, unfinished=unfinished)
    return merge(
        loaded_station,
        load_recipe(recipe, plugins),
        load_sensor_type(sensor_type)
        if sensor_type
        else load_sensor_type(loaded_station.value.sensor_type, near=loaded_station.folder),
        load_material(material)
        if material
        else load_material(loaded_station.value.material, near=loaded_station.folder),
        seed=seed,
        plugins=plugins,
    )


def plan_of(configuration: Configuration, plugins: Plugins) -> Plan:
    """Combine the sequences of a recipe with the station they run on.

    PluginError, ConfigError if a sequence is unknown, or refuses its options.
    """
    recipe, station = configuration.recipe, configuration.station
    phases = tuple(
        PlannedPhase(
            phase.name,
            phase.sequence,
            create_plugin(
                plugins, Kind.SEQUENCE, PluginChoice(phase.sequence, phase.options), f"phase {phase.name!r}"
            ),
        )
        for phase in recipe.phases
    )
    return Plan(
        phases,
        configuration.sensor_type,
        configuration.material,
        station.indenter,
        station.motion,
        station.safety,
        configuration.seed,
        station.standards,
    )


def station_clock(configuration: Configuration) -> Clock:
    """Return the station's clock; emulated instruments have their own kind."""
    speed = configuration.station.clock_speed
    if configuration.station.emulated_scene is not None:
        from cbsr_qa.simulate.instruments.streams import WatchedClock  # other stations have no emulators

        return WatchedClock(speed=speed)
    return VirtualClock(speed=speed) if configuration.station.clock == "virtual" else RealClock()


def open_station(
    configuration: Configuration,
    plugins: Plugins,
    clock: Clock,
    *,
    resumed_at_s: float = 0.0,
    ask: Callable[[str], str] | None = None,
    emulated: "Callable[[Emulation], None]" = lambda emulation: None,
) -> Bench:
    """Open every instrument of the station; emulators start first and end with the bench.

    InstrumentError if one does not answer; ConfigError if one differs from the station file, or a real one is on a
    virtual clock.

    Parameters
    ----------
    resumed_at_s, ask : fields of :class:`~cbsr_qa.plugin.instruments.StationContext`.
    emulated : function called with the emulation, if any: to arm faults, or to inspect its world.
    """
    rigs = []

    def note_rig(emulation: "Emulation") -> None:
        rigs.append(emulation.rig)
        emulated(emulation)

    open_one, closing_actions = opener(
        configuration, plugins, clock, resumed_at_s=resumed_at_s, ask=ask, emulated=note_rig
    )
    begin_step = rigs[0].begin_step if rigs else None
    bench = open_bench(configuration.station.instruments, open_one, after=closing_actions, begin_step=begin_step)
    try:
        check_clock(configuration, bench.identities())
    except BaseException as error:
        if isinstance(error, KeyboardInterrupt):  # a refusal moves nothing
            bench.safe_state()
        bench.close()
        raise
    return bench


def opener(
    configuration: Configuration,
    plugins: Plugins,
    clock: Clock,
    *,
    resumed_at_s: float = 0.0,
    ask: Callable[[str], str] | None = None,
    emulated: "Callable[[Emulation], None]" = lambda emulation: None,
) -> tuple[Callable[[InstrumentSpec], Instrument], tuple[Action, ...]]:
    """Start the station's emulators; see :func:`open_station` for parameters and errors.

    Returns a function that opens one instrument, and actions once all of them are closed.
    """
    emulation = _start_emulation(configuration, plugins, clock, resumed_at_s)
    if emulation is not None:
        emulated(emulation)

    def open_instrument(spec: InstrumentSpec) -> Instrument:
        addressed_spec = spec if emulation is None else emulation.fill_address(spec)
        return _open_instrument(addressed_spec, configuration, plugins, clock, resumed_at_s, ask)

    return open_instrument, () if emulation is None else (("emulated instruments", emulation.close),)


def check_clock(configuration: Configuration, instruments: Iterable[InstrumentIdentity]) -> None:
    """Refuse real instruments on a virtual clock (ConfigError)."""
    real = [identity.role for identity in instruments if not identity.simulated]
    if real and configuration.station.clock == "virtual":
        remedy = 'set clock = "real" in the station file: real instruments need real time'
        if configuration.station.emulated_scene is not None:
            remedy = "put real and emulated instruments into two station files: they have no clock in common"
        raise ConfigError(
            f"station {configuration.station.name!r} has a virtual clock, but {', '.join(real)} is a real instrument",
            remedy=remedy,
        )


def _start_emulation(
    configuration: Configuration, plugins: Plugins, clock: Clock, resumed_at_s: float
) -> "Emulation | None":
    station = configuration.station
    if station.emulated_scene is None:
        return None
    for spec in station.instruments:
        plugins.factory(Kind.INSTRUMENT, spec.driver)  # a misspelt name is not a driver without an emulator
    from cbsr_qa.plugin.links.taps import is_replaying

    if is_replaying():
        return None
    from cbsr_qa.simulate.instruments.rig import EmulatedRig, Emulation  # other stations have no emulators
    from cbsr_qa.simulate.instruments.streams import WatchedClock

    if station.clock != "virtual" or not isinstance(clock, WatchedClock):
        raise ConfigError(
            f"station {station.name!r} emulates instruments on a real clock",
            remedy='set clock = "virtual": emulated time advances by commands, without waiting',
        )

    world = SimulatedWorld(
        load_scene(station.emulated_scene).value,
        configuration.sensor_type,
        configuration.material,
        station.indenter,
        seed=configuration.seed,
        effect_factory=lambda name: plugins.factory(Kind.EFFECT, name),
        began_s=resumed_at_s,
    )
    return Emulation(station.instruments, EmulatedRig(clock, world, station.motion), plugins.emulator)


def _read_recording(plugins: Plugins, path: Path, format_: str | None, dataset: str | None) -> Recording:
    from cbsr_qa.analysis.recording.reading import read_recording_file  # few stations replay a recording

    return read_recording_file(path, plugins, format_=format_, dataset=dataset)


def _open_instrument(
    spec: InstrumentSpec,
    configuration: Configuration,
    plugins: Plugins,
    clock: Clock,
    resumed_at_s: float,
    ask: Callable[[str], str] | None,
) -> Instrument:
    context = StationContext(
        role=spec.role,
        clock=clock,
        sensor_type=configuration.sensor_type,
        material=configuration.material,
        indenter=configuration.station.indenter,
        seed=configuration.seed,
        options=spec.options,
        motion=configuration.station.motion,
        resumed_at_s=resumed_at_s,
        safety=configuration.station.safety,
        ask=ask,
    )
    return open_instrument(spec.driver, plugins, context)


def open_instrument(driver: str, plugins: Plugins, context: StationContext) -> Instrument:
    """Open one instrument, which is given the scene in its options and the readers of recordings and effects.

    PluginError if there is no such driver; InstrumentError if the instrument does not answer; ConfigError if its
    options are refused.
    """
    options: dict[str, Any] = dict(context.options)
    scene: Mapping[str, Any] | None = options.pop("scene", None)
    full_context = replace(
        context,
        options=options,
        scene=None if scene is None else load_scene(scene).value,
        effect_factory=lambda name: plugins.factory(Kind.EFFECT, name),
        read_recording=partial(_read_recording, plugins),
    )
    factory = plugins.factory(Kind.INSTRUMENT, driver)
    try:
        with blame_plugin(f"instrument {context.role!r}"):
            instrument: Instrument = factory(full_context)
    except (PluginError, ConfigError) as error:
        subject = f"instrument {context.role!r}"
        full_subject, reason = f"{subject} ({driver})", error.reason
        if not reason.startswith(full_subject):
            reason = (
                f"{full_subject}{reason.removeprefix(subject)}"
                if reason.startswith(subject)
                else f"{full_subject}: {reason}"
            )
        raise ConfigError(reason, remedy=error.remedy) from error
    return instrument
