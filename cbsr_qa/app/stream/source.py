"""Sources of the frames of a stream: an instrument opened by its driver alone, or that of a station."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from typing import Any, Final

from cbsr_qa.config.loader import load_material
from cbsr_qa.config.station import IndenterTable
from cbsr_qa.domain.errors import ConfigError, InstrumentError, PluginError, RefusedError
from cbsr_qa.domain.plan.plan import InstrumentSpec
from cbsr_qa.domain.readings.frames import FrameBlock
from cbsr_qa.domain.readings.loads import Indenter
from cbsr_qa.domain.run.run import InstrumentIdentity
from cbsr_qa.domain.sensor.sensor_type import SensorType
from cbsr_qa.plugin.discovery import Plugins
from cbsr_qa.plugin.failures import blame_plugin
from cbsr_qa.plugin.instruments import FrameSource, Instrument, Linked, StationContext
from cbsr_qa.station.bench import FRAME_SOURCE, MULTIPLEXER, SOURCE_METER, Mounted, identity_of, stop_all
from cbsr_qa.station.control.lock import station_held
from cbsr_qa.station.setup import check_clock, configure, open_instrument, opener, station_clock
from cbsr_qa.system.clock import Clock, RealClock

#: Material for simulated instruments; real ones do not use it.
_MATERIAL: Final = "cbsr-8wt"
#: Recipe that a station is configured with; a stream does not use it.
_RECIPE: Final = "golden-check"


@dataclass(frozen=True, slots=True)
class FramesFrom:
    """Which instrument takes the frames: give a driver with its options, or a station.

    Parameters
    ----------
    driver, options : driver and options as in the instrument's table of a station file.
    station : station file, or the name of a shipped one: its frame source is used, and what that works through.
    """

    driver: str | None = None
    options: Mapping[str, Any] | None = None
    station: str | None = None


@dataclass(frozen=True, slots=True)
class OpenedSource:
    """An instrument that takes frames."""

    spec: InstrumentSpec
    instrument: FrameSource
    clock: Clock
    identity: InstrumentIdentity

    def frame(self) -> FrameBlock:
        """Take the next frame.

        Raise InstrumentError if the instrument fails, whatever its driver raises, and NoMoreFramesError after the
        last frame.
        """
        try:
            with blame_plugin(f"driver {self.spec.driver}"):
                return self.instrument.acquire(1)
        except PluginError as error:
            raise InstrumentError(
                self.spec.role, self.spec.address, error.reason, remedy="report it to the driver's author"
            ) from error


@contextmanager
def open_source(
    frames: FramesFrom,
    plugins: Plugins,
    sensor_type: SensorType,
    head: Indenter | None,
    tell: Callable[[str], None] = lambda words: None,
) -> Iterator[OpenedSource]:
    """Open the instrument; it is made safe and closed at the end.

    Parameters
    ----------
    sensor_type, head : sensor type and head of the calibration; None where it does not tell its head.
    tell : called with what could not be made safe or closed.

    Raises
    ------
    RefusedError
        If driver or station are unknown, refuse their options, take no frames, or are of another sensor type; or if
        another process uses the station.
    InstrumentError
        If an instrument does not answer.
    """
    if (frames.driver is None) == (frames.station is None):
        raise RefusedError(
            "give either a driver or a station" if frames.driver is None else "a driver and a station are given",
            remedy="--from DRIVER opens one instrument, --station STATION the frame source of a station",
        )
    with ExitStack() as stack:
        if frames.driver is not None:
            specs, clock, opened = _open_alone(frames.driver, frames.options or {}, plugins, sensor_type, head)
        else:
            assert frames.station is not None
            specs, clock, opened = _prepare_station(frames.station, plugins, sensor_type, stack)
        mounted = []
        for spec in specs:
            instrument = Mounted(spec, opened(spec))
            mounted.append(instrument)
            stack.callback(_close_instrument, instrument, tell)
        yield _ready(mounted, clock)


def _close_instrument(one: Mounted, tell: Callable[[str], None]) -> None:
    for action in (one.instrument.safe_state, one.instrument.close):
        for problem in stop_all([(one.name, action)]):
            tell(f"{problem}: switch its current off by hand")


_Opener = Callable[[InstrumentSpec], Instrument]
_Opened = tuple[list[InstrumentSpec], Clock, _Opener]


def _open_alone(
    driver: str, options: Mapping[str, Any], plugins: Plugins, sensor_type: SensorType, head: Indenter | None
) -> _Opened:
    clock = RealClock()
    # Nothing presses here, but simulated instruments need a head: take the one of a station that states none.
    indenter = IndenterTable().to_domain() if head is None else head
    if options.get("address") == "emulated":
        raise ConfigError(
            f"{driver}: only a station emulates instruments", remedy="give --station, e.g. --station board-emulated"
        )

    def open_alone(spec: InstrumentSpec) -> Instrument:
        context = StationContext(
            FRAME_SOURCE, clock, sensor_type, load_material(_MATERIAL).value, indenter, 0, spec.options
        )
        return open_instrument(spec.driver, plugins, context)

    return [InstrumentSpec(FRAME_SOURCE, driver, (FRAME_SOURCE,), options, None)], clock, open_alone


def _prepare_station(station: str, plugins: Plugins, sensor_type: SensorType, stack: ExitStack) -> _Opened:
    """Open no head and no load cell: whoever built the sensor in presses."""
    configuration = configure(station, _RECIPE, sensor_type=None, material=None, seed=0, plugins=plugins)
    _check_sensor_type(configuration.station.name, configuration.sensor_type, sensor_type)
    stack.enter_context(station_held(configuration.station.name, who="", doing="streaming forces"))
    if configuration.station.clock == "virtual":  # time passes as for whoever reads
        configuration = replace(
            configuration,
            station=replace(configuration.station, clock_speed=configuration.station.clock_speed or 1.0),
        )
    clock = station_clock(configuration)
    opened, callbacks = opener(configuration, plugins, clock)
    if callbacks:
        stack.callback(stop_all, callbacks)
    specs = configuration.station.instruments
    source = next(spec for spec in specs if FRAME_SOURCE in spec.provides)
    linked_specs = [spec for spec in specs if spec is not source and {SOURCE_METER, MULTIPLEXER} & set(spec.provides)]

    def open_checked(spec: InstrumentSpec) -> Instrument:
        instrument = opened(spec)
        if not isinstance(instrument, Linked):  # it is as real as those that it works through
            check_clock(configuration, [identity_of(Mounted(spec, instrument))])
        return instrument

    return [*linked_specs, source], clock, open_checked


def _check_sensor_type(station: str, has: SensorType, calibrated: SensorType) -> None:
    """Refuse a station whose frames are not those of the calibrated sensor."""
    own_pattern, calibrated_pattern = has.pattern, calibrated.pattern
    if has.name == calibrated.name and (own_pattern.drive, own_pattern.measure) == (
        calibrated_pattern.drive,
        calibrated_pattern.measure,
    ):
        return
    mismatch = f"has sensor type {has.name!r}, the calibration is of a {calibrated.name!r}"
    if has.name == calibrated.name:
        mismatch = f"drives or measures sensor type {has.name!r} in another pattern than the calibration"
    raise ConfigError(
        f"station {station!r} {mismatch}",
        remedy="give the calibration of the sensor at this station, or set sensor_type in the station file",
    )


def _ready(mounted: list[Mounted], clock: Clock) -> OpenedSource:
    """Link the frame source, which was opened last, with the others, and ask who it is."""
    source = mounted[-1]
    instrument = source.instrument
    if not isinstance(instrument, FrameSource):
        raise ConfigError(
            f"driver {source.spec.driver!r} takes no frames", remedy="give the driver of a frame source"
        )
    if isinstance(instrument, Linked):
        if len(mounted) == 1:
            raise ConfigError(
                f"driver {source.spec.driver!r} works through other instruments",
                remedy="describe them in a station file, and give --station FILE",
            )
        with blame_plugin(f"instrument {source.name}"):
            instrument.link({role: one.instrument for one in mounted for role in one.spec.provides})
    emulated = any(one.spec.emulated for one in mounted)
    return OpenedSource(source.spec, instrument, clock, identity_of(source, emulated=emulated))
