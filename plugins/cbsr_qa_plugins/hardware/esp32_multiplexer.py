"""The 16-channel multiplexer on an ESP32 with its command firmware: one byte a command, each echoed."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Annotated, Final, Literal

from pydantic import Field

from cbsr_qa.plugin import (
    CheckResult,
    InstrumentError,
    InstrumentIdentity,
    PluginOptions,
    RefusedError,
    SerialLink,
    StationContext,
    driver,
)
from cbsr_qa.system.clock import RealClock
from cbsr_qa_plugins.hardware._driver import Baud, DriverBase, Port, check_result, close_on_error, config_error
from cbsr_qa_plugins.hardware._esp32 import Connection, Order, counter_in, is_log, last_position, stepping_order

_DRIVER: Final = "esp32-multiplexer"
#: Electrodes between the two of a pair.
Skip = Annotated[int, Field(ge=0, le=10**6)]

#: Of the board: more electrodes cannot be connected to it.
_CHANNELS: Final = 16
_ESCAPE: Final = b"\x1b"
#: The counter arrives with the next log line, up to a second after the query.
_COUNTER_S: Final = 1.5
#: Out of step, this long a silence says that nothing more is to come [s, real time].
_QUIET_S: Final = 0.15
#: Out of step, an answer may come this many timeouts late.
_PATIENCE: Final = 8.0
#: How often a pulled cable is looked for [s, real time].
_LOOK_AGAIN_S: Final = 0.2


class MultiplexerOptions(PluginOptions):
    address: Port
    baud: Baud = 115200
    inner: Literal["current", "voltage"]
    current_skip: Skip = 0
    voltage_skip: Skip = 0
    settle_ms: Annotated[float, Field(ge=0, le=1000)] = 1.0
    boot_s: Annotated[float, Field(ge=0, le=60)] = 3.0
    timeout_s: Annotated[float, Field(ge=0.01, le=60)] = 0.5
    reconnect_s: Annotated[float, Field(ge=0, le=600)] = 10.0


@driver(_DRIVER, MultiplexerOptions)
def open_multiplexer(context: StationContext, options: MultiplexerOptions) -> "Esp32Multiplexer":
    """Open a multiplexer (role ``multiplexer``); opening its port restarts it.

    Options of its table
    --------------------
    address : serial port.
    baud : baud rate.
    inner : ``"current"`` if the driven pair changes with every step, else ``"voltage"``.
    current_skip, voltage_skip : electrodes between the two of a pair, 0 for neighbours.
    settle_ms : waiting time after a step.
    boot_s : longest time that it takes to start.
    timeout_s : longest time for an answer.
    reconnect_s : how long to wait for a pulled cable.

    Raises
    ------
    ConfigError
        If an option is unknown or out of range, or the sensor type has more than 16 electrodes or other pairs than
        the firmware.
    InstrumentError
        If the port cannot be opened, something else answers, or it steps in another order than ``inner`` says.
    """
    return Esp32Multiplexer(context, options)


class Esp32Multiplexer(DriverBase):
    """Steps by ``i``, and is asked where it is by ``g``: a step that was lost or done twice does not stay unseen.

    After any failure it is resynchronised before it is used again; if that does not help, its port is opened anew,
    which restarts it.
    """

    def __init__(self, context: StationContext, options: MultiplexerOptions) -> None:
        super().__init__(context, _DRIVER, options.address)
        self._options = options
        self._time = RealClock()
        self._pattern = context.sensor_type.pattern
        if self._pattern.electrode_count > _CHANNELS:
            name, count = context.sensor_type.name, self._pattern.electrode_count
            problem = f" connects {_CHANNELS} electrodes; sensor type {name!r} has {count}"
            raise config_error(context, _DRIVER, problem, "use a smaller sensor type, or another multiplexer")
        self._order = self._build_order()
        self._lock = threading.RLock()
        self._in_step = False
        #: Index of the connected combination; None if a query is needed.
        self._position: int | None = None
        self._link = SerialLink(self._role, options.address, baud=options.baud, timeout_s=options.timeout_s)
        with close_on_error(self._link):
            self._await_boot()
            self._check_order()

    # --- instrument ---

    def identity(self) -> InstrumentIdentity:
        """Its firmware says nothing of itself; what it does is its identity."""
        with self._talking():
            self._ask_position()
        notes = (("order", f"{self._options.inner} pair inner"),)
        return self._build_identity("ESP32 16-channel multiplexer", "", "command firmware", notes=notes)

    def close(self) -> None:
        self._link.close()

    def alive(self) -> None:
        """Check that its combination is unchanged. InstrumentError if it does not answer, or has restarted."""
        with self._talking():
            before = self._position
            if self._ask_position() != before and before is not None:
                raise self._error("it has been restarted: it is not where it was left", retryable=True)

    def self_test(self) -> tuple[CheckResult, ...]:
        """Step through a whole round, and check that it ends where it began (line ``round``)."""
        with self._talking():
            self._step_to_start()
            for _ in self._order:
                self._step_once()
            end = self._ask_position()
        count = len(self._order)
        result = f"{count} steps lead from the first combination to number {end + 1}"
        remedy = "steps are lost or done twice: look at the cable, and at what else is on its supply"
        return (check_result("round", end == 0, said=result, remedy=remedy),)

    # --- multiplexer ---

    def order(self) -> Order:
        """Return the combinations in the order it steps through them."""
        return self._order

    def start(self) -> None:
        """Step on to the first combination, and see that it is there.

        InstrumentError if it does not get there, or an answer is lost (both retryable).
        """
        with self._talking():
            moved = self._step_to_start()
        if moved:
            self._clock.sleep(1e-3 * self._options.settle_ms)

    def step(self) -> None:
        """Connect the next combination; returns when it has settled.

        InstrumentError if the step is not echoed (retryable).
        """
        with self._talking():
            self._step_once()
        self._clock.sleep(1e-3 * self._options.settle_ms)

    def position(self) -> int:
        """Ask which combination is connected; its index in :meth:`order`."""
        with self._talking():
            return self._ask_position()

    # --- how ---

    def _build_order(self) -> Order:
        skips = self._options.model_dump(include={"current_skip", "voltage_skip"})
        last_column = self._pattern.electrode_count - 2
        for key, skip in skips.items():
            if skip > last_column:
                remedy = f"it must be at most {last_column} with the electrodes of this sensor type"
                raise config_error(self._context, _DRIVER, f": {key} is {skip}", remedy)
        try:
            return stepping_order(self._pattern, inner=self._options.inner, **skips)
        except RefusedError as error:
            raise config_error(self._context, _DRIVER, f": {error.reason}", error.remedy) from error

    def _await_boot(self) -> None:
        """Ask until it answers: while it starts, what it is sent is lost."""
        until_s = self._time.now() + self._options.boot_s
        while True:
            try:
                self._ask_position()
            except InstrumentError:
                if self._time.now() >= until_s:
                    raise
            else:
                self._in_step = True
                return

    def _check_order(self) -> None:
        """Check by two steps and the counter that it follows the station file."""
        with self._talking():
            self._check_counter(self._ask_position())
            self._step_to_start()
            self._step_once()
            expected, reached = self._position, self._ask_position()
            if reached != expected:
                (drive, measure), declared = self._order[reached], self._order[1]
                raise self._error(
                    f"after the first step it connects drive pair {drive} and measure pair {measure};"
                    f" with inner = {self._options.inner!r} it is to be {declared[0]} and {declared[1]}",
                    remedy="correct inner in its table: the pair that changes with every step is the inner one",
                )

    def _step_to_start(self) -> bool:
        """Step on to the first combination; false if already there."""
        position = self._ask_position() if self._position is None else self._position
        if position == 0:
            return False
        for _ in range(len(self._order) - position):
            self._step_once()
        if (reached := self._ask_position()) != 0:
            raise self._error(f"told to go to its first combination, it is at number {reached + 1}", retryable=True)
        return True

    def _check_counter(self, position: int) -> None:
        """Compare its counter with its combination; a missing counter is accepted."""
        self._link.flush_input()
        self._link.write(b"c")
        until_s, answer = self._time.now() + _COUNTER_S, b""
        while self._time.now() < until_s and (counter := counter_in(answer)) is None:
            with suppress(InstrumentError):
                answer += self._link.read(1, timeout_s=_QUIET_S)
        if counter is not None and counter % len(self._order) != position:
            raise self._error(f"its counter is at {counter}, and it connects combination number {position + 1}")

    @contextmanager
    def _talking(self) -> Iterator[None]:
        """Have it alone and in step; what ends an exchange early leaves it to be brought back into step."""
        with self._lock:
            in_step, self._in_step = self._in_step, False
            if not in_step:
                self._recover()
            try:
                yield
            except InstrumentError as error:
                # Also a line that hung up may be tried again: by then it may be plugged in again.
                raise self._restate_error(error, retryable=error.retryable or self._link.down) from error
            self._in_step = True

    def _recover(self) -> None:
        self._position = None
        with suppress(InstrumentError):
            self._ask_position(late=True)
            return
        until_s = self._time.now() + self._options.reconnect_s
        while True:
            try:
                self._link.reopen()
                return self._await_boot()
            except InstrumentError as error:
                if self._time.now() >= until_s:
                    raise self._restate_error(error, retryable=False) from error
            self._time.sleep(_LOOK_AGAIN_S)

    def _step_once(self) -> None:
        before, self._position = self._position, None
        self._forget()
        self._link.write(b"i")
        echo = self._link.read(1)
        while echo == _ESCAPE:  # a log line came in between
            self._link.read_line()
            echo = self._link.read(1)
        if echo != b"i":
            raise self._error(f"echoed {echo!r} to 'i'", retryable=True)
        self._position = None if before is None else (before + 1) % len(self._order)

    def _forget(self) -> None:
        """Discard unrequested output, including the rest of a log line."""
        unread = self._link.read_available()
        if unread.rfind(_ESCAPE) > unread.rfind(b"\n") or is_log(unread.rpartition(b"\n")[2]):
            self._link.read_line()

    def _ask_position(self, *, late: bool = False) -> int:
        """Ask where it is.

        ``late``: answers to earlier questions may still come: wait until there are no more, and take the last.
        """
        self._forget()
        self._link.write(b"g")
        answer, connection = b"", None
        until_s = self._time.now() + self._options.timeout_s * (_PATIENCE if late else 1.0)
        while connection is None and self._time.now() < until_s:
            answer += self._line(self._options.timeout_s)
            connection = last_position(answer)
        while late and (more := self._line(_QUIET_S)):
            connection = last_position(more) or connection
        connection = last_position(self._link.read_available()) or connection
        if connection is None:
            raise self._error(
                f"asked which electrodes it connects, it says {repr(answer[-80:]) if answer else 'nothing'}",
                remedy="a multiplexer with the command firmware is expected; check address, baud rate and firmware",
                retryable=True,
            )
        self._position = self._index(connection)
        return self._position

    def _line(self, timeout_s: float) -> bytes:
        """Return the next line, or nothing after a timeout."""
        try:
            return self._link.read_line(timeout_s) + b"\n"
        except InstrumentError as error:
            if not error.retryable:
                raise
            return b""

    def _index(self, connection: Connection) -> int:
        (source, sink), voltage = connection
        drives = [index for index, pair in enumerate(self._pattern.drive) if pair == (source, sink)]
        measures = [index for index, pair in enumerate(self._pattern.measure) if set(pair) == set(voltage)]
        for drive in drives:
            for measure in measures:
                if (drive, measure) in self._order:
                    return self._order.index((drive, measure))
        raise self._error(
            f"it drives from electrode {source} to {sink} and measures between {voltage[0]} and {voltage[1]},"
            " which are not pairs of the sensor type",
            remedy="correct current_skip and voltage_skip in its table, or the sensor type's pattern",
        )
