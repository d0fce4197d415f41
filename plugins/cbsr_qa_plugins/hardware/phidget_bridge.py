"""Load cell at a PhidgetBridge (1046 and others with a bridge input), through the library Phidget22.

Not tried on the hardware. Its calls are those of Phidget22 1.26, whose library was loaded and queried for a missing
device; everything else is tested against a stand-in for the library.
"""

import ctypes
import sys
from contextlib import suppress
from importlib import import_module
from typing import Annotated, Any, Final, Literal

import numpy as np
from pydantic import Field

from cbsr_qa.domain.numbers import Array
from cbsr_qa.plugin import ConfigError, InstrumentError, StationContext, WholeNumber, driver
from cbsr_qa.plugin.links.locks import AddressLock
from cbsr_qa.plugin.links.taps import is_replaying
from cbsr_qa_plugins.hardware._driver import DriverBase, Factor, close_on_error
from cbsr_qa_plugins.hardware._force_cell import CellOptions, ForceCell
from cbsr_qa_plugins.hardware._line_sampler import SampleLog

_DRIVER: Final = "phidget-bridge"
_TIMEOUT: Final = 0x3  # no device attached in time
_SILENT_INTERVALS: Final = 10
_INSTALL: Final = 'install it with: pip install "cbsr-qa[phidget]"'
_LIBUSB: Final = (
    "install libusb with your system's packages (Debian: apt install libusb-1.0-0), or: pip install libusb-package"
)
_PLUG: Final = "plug it in; on Linux its udev rule (99-libphidget22.rules) must let this user open it"


class BridgeOptions(CellOptions):
    scale: Factor
    device_serial: Annotated[int, Field(ge=0, le=2**31)] | None = None
    channel: Annotated[int, Field(ge=0, le=7)] = 0
    gain: Annotated[Literal[1, 8, 16, 32, 64, 128], WholeNumber] = 128
    data_interval_ms: Annotated[int, Field(ge=8, le=60_000)] = 125
    attach_s: Annotated[float, Field(ge=0.01, le=60)] = 5.0


@driver(_DRIVER, BridgeOptions)
def open_bridge(context: StationContext, options: BridgeOptions) -> ForceCell:
    """Open a bridge input as load cell; it samples ``force`` [N], compression positive.

    Options of its table
    --------------------
    device_serial : serial number of the bridge; by default the first bridge found.
    channel : input of the bridge.
    gain : of the bridge's amplifier.
    data_interval_ms : time between samples.
    attach_s : how long to wait for the bridge.
    scale, offset : grams = scale × ratio + offset, ratio in V/V; the rig's are 4.94462e6 and 70.13.
    sign : -1 if compression reads negative, as on the rig.
    limit_N : end of the cell's range: readings at this value break the run; 7.34 for the rig's cell.
    tare_s : the mean over this time at opening becomes the zero; 0: no tare.
    tare_limit_N : a larger force at opening is a load, not a zero.
    dead_weight_g : a known mass for the check of the station.

    Raises
    ------
    ConfigError
        If an option is unknown, missing or out of range, or the library is not installed.
    InstrumentError
        If the bridge does not attach, or something presses on the cell while it is tared.
    """
    source = PhidgetSource(context, options)
    with close_on_error(source):
        cell = ForceCell(context, source, options, driver=_DRIVER, address=source.address, who=source.identity)
        cell.tare()
        return cell


class PhidgetSource(DriverBase):
    """Forces from one input of a bridge; the library calls from a thread of its own.

    An unplugged bridge is reported at the next check, and used again once it is back: the library knows it by its
    serial number. ConfigError if the library is not installed, or libusb is missing; InstrumentError if the bridge
    does not attach.
    """

    def __init__(self, context: StationContext, options: BridgeOptions) -> None:
        serial = "any" if options.device_serial is None else options.device_serial
        super().__init__(context, _DRIVER, f"phidget:{serial}:{options.channel}")
        self._options = options
        self._log = SampleLog()
        self._attached = False
        self._complaint = ""  # the last thing the library complained of
        self._began_s = self._clock.now()
        if is_replaying():
            raise self._error("a transcript does not keep what the bridge's library says", "check it on the bench")
        self._input = _bridge_input(self._role)
        self._lock = AddressLock(self._role, self._address)
        with close_on_error(self):
            self._open()
        self._began_s = self._clock.now()

    @property
    def address(self) -> str:
        """Serial number and channel, for messages."""
        return self._address

    def identity(self) -> tuple[str, str, str]:
        """Ask the bridge for its model, serial number and firmware."""
        try:
            model, serial = self._input.getDeviceName(), self._input.getDeviceSerialNumber()
            version = self._input.getDeviceVersion()
        except Exception as error:
            raise self._bridge_error("does not say who it is", error) from error
        return str(model), str(serial), str(version)

    def samples_since(self, time_s: float) -> tuple[Array, Array]:
        """Return times [s] and forces [N], both (n,), after a time. InstrumentError while it is unplugged."""
        if not self._attached:
            complaint = f" ({self._complaint})" if self._complaint else ""
            raise self._error(f"the bridge is unplugged{complaint}", _PLUG)
        return self._log.read_since(time_s)

    def newest(self, count: int) -> Array:
        """Return the last forces [N], at most so many, (n,)."""
        return self._log.newest(count)

    def check_alive(self) -> None:
        """Raise InstrumentError if it is unplugged or has fallen silent."""
        self.samples_since(np.inf)
        silent_s = 1.0 + _SILENT_INTERVALS * self._options.data_interval_ms / 1e3
        if self._clock.now() - max(self._log.last_s, self._began_s) > silent_s:
            complaint = f"; its library said: {self._complaint}" if self._complaint else ""
            raise self._error(f"it has sent nothing for {silent_s:.3g} s{complaint}", "check cell, cable and bridge")

    def close(self) -> None:
        with suppress(Exception):  # the library raises if it is not open
            self._input.setOnVoltageRatioChangeHandler(None)
            self._input.close()
        self._lock.release()

    def _open(self) -> None:
        bridge, options = self._input, self._options
        try:
            if options.device_serial is not None:
                bridge.setDeviceSerialNumber(options.device_serial)
            bridge.setChannel(options.channel)
            bridge.setOnAttachHandler(self._on_attach)
            bridge.setOnDetachHandler(self._on_detach)
            bridge.setOnErrorHandler(self._on_error)
            bridge.setOnVoltageRatioChangeHandler(self._on_ratio)
            bridge.openWaitForAttachment(round(1e3 * options.attach_s))
            self._set_up(bridge)
        except Exception as error:
            if getattr(error, "code", None) == _TIMEOUT:
                raise self._error(f"no bridge attached within {options.attach_s:g} s", _PLUG) from error
            raise self._bridge_error("does not open", error) from error
        self._attached = True

    def _set_up(self, bridge: Any) -> None:
        """Set what a bridge forgets when unplugged; every interval gives a sample, even without a change."""
        gains = import_module("Phidget22.BridgeGain").BridgeGain
        bridge.setBridgeGain(getattr(gains, f"BRIDGE_GAIN_{self._options.gain}"))
        bridge.setDataInterval(self._options.data_interval_ms)
        bridge.setVoltageRatioChangeTrigger(0.0)

    # --- called by the library, in its thread; nothing may be raised into it ---

    def _on_attach(self, bridge: Any) -> None:
        try:
            self._set_up(bridge)
            self._attached = True
        except Exception as error:  # noqa: BLE001 - told at the next look
            self._complaint = str(error)

    def _on_detach(self, bridge: Any) -> None:
        self._attached = False

    def _on_error(self, bridge: Any, code: int, description: str) -> None:
        self._complaint = f"{description} ({code})"

    def _on_ratio(self, bridge: Any, ratio: float) -> None:
        now_s = self._clock.now()
        if now_s > self._log.last_s:  # a virtual clock may not have moved: one sample a moment
            self._log.append(now_s, self._options.force_N(ratio, "g"))

    def _bridge_error(self, what: str, error: Exception) -> InstrumentError:
        details = getattr(error, "details", "") or getattr(error, "description", "") or error
        return self._error(f"the bridge {what}: {details}", _PLUG)


def _bridge_input(role: str) -> Any:
    """Create a bridge input of the library, which loads libusb."""
    try:
        devices = import_module("Phidget22.Devices.VoltageRatioInput")
    except ImportError as error:
        raise ConfigError(
            f"instrument {role!r} needs the library Phidget22, which is missing", remedy=_INSTALL
        ) from error
    _preload_libusb()
    try:
        return devices.VoltageRatioInput()
    except OSError as error:
        raise ConfigError(f"instrument {role!r}: Phidget22 finds no libusb ({error})", remedy=_LIBUSB) from error


def _preload_libusb() -> None:
    """Load the libusb of the package libusb-package, if it is there: Phidget22 then finds it in the process."""
    if not sys.platform.startswith("linux"):
        return
    with suppress(ImportError, OSError, TypeError):
        ctypes.CDLL(str(import_module("libusb_package").get_library_path()), mode=ctypes.RTLD_GLOBAL)
