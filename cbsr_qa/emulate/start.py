"""Start the emulated instruments of a station, each on a byte stream of its own."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from importlib import import_module
from types import TracebackType
from typing import Any, Final, Self

from cbsr_qa.domain.errors import ConfigError
from cbsr_qa.domain.plan import EMULATED, InstrumentSpec
from cbsr_qa.emulate.faults import Fault
from cbsr_qa.emulate.rig import EmulatedRig
from cbsr_qa.emulate.streams import FreeRunning, Port, PtyPort, Served, TcpPort

#: Driver → (module below this package, class, stream). Imported only where a station emulates one.
EMULATORS: Final[Mapping[str, tuple[str, str, type[Port]]]] = {
    "keithley-2600": ("source_meter", "EmulatedSourceMeter", TcpPort),
    "esp32-multiplexer": ("multiplexer", "EmulatedMultiplexer", PtyPort),
    "marlin-applicator": ("applicator", "EmulatedApplicator", PtyPort),
    "serial-load-cell": ("load_cell", "EmulatedLoadCell", PtyPort),
    "serial-thermometer": ("thermometer", "EmulatedThermometer", PtyPort),
    "ert-board-stream": ("ert_board", "EmulatedErtBoard", PtyPort),
}


class Emulation:
    """Running emulators of one station; a context manager, or closed by hand.

    Parameters
    ----------
    specs : the station's instruments; those whose address is "emulated" are served.
    rig : the world they share.

    Raises
    ------
    ConfigError
        If there is no emulator for a driver.
    """

    def __init__(self, specs: Iterable[InstrumentSpec], rig: EmulatedRig) -> None:
        self.rig = rig
        self.ports: dict[str, Port] = {}
        self.instruments: dict[str, Served] = {}
        try:
            for spec in specs:
                if spec.emulated:
                    self._start(spec)
        except BaseException:
            self.close()
            raise

    def addressed(self, spec: InstrumentSpec) -> InstrumentSpec:
        """Return an instrument's table with the address its emulator is at; others as they are.

        The table says no more that it is emulated: ask the one it came from.
        """
        if spec.role not in self.ports:
            return spec
        return replace(spec, options={**spec.options, "address": self.ports[spec.role].address})

    def arm(self, role: str, fault: Fault) -> None:
        """Let the next command to an instrument meet a fault."""
        self.ports[role].faults.arm(fault)

    def close(self) -> None:
        """End every emulator."""
        for port in self.ports.values():
            port.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _start(self, spec: InstrumentSpec) -> None:
        if spec.driver not in EMULATORS:
            raise ConfigError(
                f"instrument {spec.role!r} has address {EMULATED!r}, but driver {spec.driver!r} has no emulator",
                remedy=f"emulated are: {', '.join(sorted(EMULATORS))}",
            )
        module, name, stream = EMULATORS[spec.driver]
        make: Callable[[EmulatedRig, Mapping[str, Any], Callable[[bytes], None]], Served]
        make = getattr(import_module(f"cbsr_qa.emulate.{module}"), name)
        port = self.ports[spec.role] = stream(f"emulated {spec.role}")
        instrument = self.instruments[spec.role] = make(self.rig, spec.options, port.send)
        if isinstance(instrument, FreeRunning):
            instrument.attached(port)
        port.serve(instrument)
