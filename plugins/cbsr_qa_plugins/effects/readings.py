"""Effects of source and voltmeter: noise, mains, input resistance, and a source whose voltage ends."""

from typing import Annotated, Final

import numpy as np
from pydantic import Field
from scipy.constants import Boltzmann, zero_Celsius

from cbsr_qa.domain.numbers import Array
from cbsr_qa.plugin import ConfigError, Moment, PluginOptions, ReadingFlag, SceneSetting
from cbsr_qa.simulate.effect import Amount, Electrode, Positive, SceneEffect, check_electrode
from cbsr_qa.simulate.streams import RandomStream

#: What the materials' noise is stated at: the rig's script reads at 0.01 power line cycles. The paper prints none.
REFERENCE_NPLC: Final = 0.01
Cycles = Annotated[float, Field(gt=0, le=25)]


class ReadingEffect(SceneEffect):
    """Changes the readings of a frame; there are none where only the force is sampled."""

    perturbs = "voltages"

    def apply(self, moment: Moment) -> None:
        if moment.voltages is not None:
            moment.voltages = self.read(moment, moment.voltages)

    def read(self, moment: Moment, voltages: Array) -> Array:
        """Return what is read in place of these voltages, (drives, measures) [V]."""
        raise NotImplementedError


class _RelativeNoise(ReadingEffect):
    """Adds Gaussian noise, relative to the mean used reading, to every frame: subclasses say how much."""

    after: tuple[str, ...] = ("voltmeter-input",)

    def _begin(self, setting: SceneSetting, name: str, relative: float | Array) -> None:
        self._relative, self._stream = relative, RandomStream(setting.seed, name)

    def read(self, moment: Moment, voltages: Array) -> Array:
        drawn = self._stream.normal(moment.index, voltages.shape)
        return voltages + self._relative * moment.reading_scale_V * drawn


class MeasurementNoise(_RelativeNoise):
    """Independent Gaussian noise, equal on all readings, that falls with the averaging time.

    White noise averaged over N power line cycles falls as √(1/N); the floor adds to it in quadrature:
    rms² = floor² + (stated² − floor²) N₀/N. At N₀ it is the stated noise, floor included.

    Departure from real converters: every reading draws a new floor, so means over frames go below it.

    Parameters
    ----------
    relative_noise : rms of one reading over the mean magnitude of the used readings of the unloaded sheet; by
        default the material's.
    nplc : N, power line cycles over which a reading is averaged; the rig reads at 0.01.
    measured_at_nplc : N₀, at which ``relative_noise`` holds.
    relative_floor : noise that averaging does not reduce, relative in the same way; at most ``relative_noise``.
    """

    class Options(PluginOptions):
        relative_noise: Annotated[float, Field(ge=0, le=1e6)] | None = None
        nplc: Cycles = REFERENCE_NPLC
        measured_at_nplc: Cycles = REFERENCE_NPLC
        relative_floor: Amount = 0.0

    options: Options

    def prepare(self, setting: SceneSetting) -> None:
        options = self.options
        stated, floor = options.relative_noise, options.relative_floor
        if stated is None:
            stated = setting.material.relative_noise.value
        if floor > stated:
            raise ConfigError(
                f"relative_floor is {floor:g}, more than the noise it is part of",
                remedy=f"it is at most relative_noise, {stated:g}",
            )
        longer = options.nplc / options.measured_at_nplc
        relative = float(np.sqrt(floor**2 + (stated - floor) * (stated + floor) / longer))
        self._begin(setting, "measurement-noise", relative)


class ElectrodeNoise(_RelativeNoise):
    """Independent Gaussian noise on every reading that uses one electrode, to drive or to measure.

    It adds to that of other effects. Readings that use the electrode twice have no more of it than the others.

    Parameters
    ----------
    electrode : number of the electrode.
    relative_noise : rms on one reading over the mean magnitude of the used readings of the unloaded sheet, as in
        ``measurement-noise``.
    """

    class Options(PluginOptions):
        electrode: Electrode
        relative_noise: Amount

    options: Options

    def prepare(self, setting: SceneSetting) -> None:
        which, pattern = self.options.electrode, setting.sensor_type.pattern
        check_electrode("electrode", which, setting)
        drives, measures = (np.array([which in pair for pair in pairs]) for pairs in (pattern.drive, pattern.measure))
        self._begin(setting, "electrode-noise", self.options.relative_noise * (drives[:, None] | measures))


class JohnsonNoise(ReadingEffect):
    """Thermal noise of the resistance of each measured pair, independent between readings.

    √(4 k T R Δf) (Nyquist 1928). Readings average over N power line cycles, Δf = 1/(2 T_int) of a rectangular window.

    Parameters
    ----------
    nplc : N, power line cycles over which a reading is averaged; the rig reads at 0.01.
    mains_Hz : mains frequency.
    temperature_C : temperature of the sheet.
    """

    class Options(PluginOptions):
        nplc: Cycles = 0.01
        mains_Hz: Positive = 50.0
        temperature_C: Annotated[float, Field(ge=-zero_Celsius, le=300)] = 23.0

    options: Options

    def prepare(self, setting: SceneSetting) -> None:
        integration_s = self.options.nplc / self.options.mains_Hz
        kelvin = zero_Celsius + self.options.temperature_C
        self._per_ohm = 4 * Boltzmann * kelvin / (2 * integration_s)
        self._stream = RandomStream(setting.seed, "johnson-noise")

    def read(self, moment: Moment, voltages: Array) -> Array:
        assert moment.measure_ohm is not None
        drawn = self._stream.normal(moment.index, voltages.shape)
        return voltages + np.sqrt(self._per_ohm * moment.measure_ohm) * drawn


class MainsHum(ReadingEffect):
    """A sine at the mains frequency on all readings, averaged over each reading's integration time.

    A sinc(N) sin(2π f t + φ) for N power line cycles: nothing is left at whole cycles, nearly all at 0.01. The phase
    is drawn once per seed.

    Parameters
    ----------
    amplitude_V : A, amplitude before averaging.
    nplc : N, integration time in power line cycles; the rig reads at 0.01.
    mains_Hz : f, mains frequency.
    """

    class Options(PluginOptions):
        amplitude_V: Amount
        nplc: Cycles = 0.01
        mains_Hz: Annotated[float, Field(gt=0, le=1e3)] = 50.0

    needs: tuple[str, ...] = ("time-skew",)
    options: Options

    def prepare(self, setting: SceneSetting) -> None:
        options = self.options
        self._amplitude_V = options.amplitude_V * float(np.sinc(options.nplc))
        self._rate_rad_s = 2 * np.pi * options.mains_Hz
        self._phase = float(RandomStream(setting.seed, "mains-hum").generator(0).uniform(0, 2 * np.pi))

    def read(self, moment: Moment, voltages: Array) -> Array:
        assert moment.reading_offsets_s is not None  # of the time-skew that it needs
        turned = self._rate_rad_s * (moment.run_s + moment.reading_offsets_s) + self._phase
        return voltages + self._amplitude_V * np.sin(turned)


class SourceCompliance(SceneEffect):
    """A driven pair that would exceed the source's voltage limit gets less current and is flagged.

    I = V_limit/R.

    Parameters
    ----------
    limit_V : voltage limit of the source; the rig's is 20 to 22 V.
    """

    class Options(PluginOptions):
        limit_V: Positive = 20.0

    perturbs = "source"
    options: Options

    def apply(self, moment: Moment) -> None:
        if moment.current_A is None or moment.drive_ohm is None or moment.flags is None:
            return
        limit_V = self.options.limit_V
        limited = moment.current_A * moment.drive_ohm > limit_V
        moment.current_A = np.divide(limit_V, moment.drive_ohm, out=moment.current_A.copy(), where=limited)
        moment.flags |= np.where(limited, np.uint8(ReadingFlag.COMPLIANCE), np.uint8(0))


class VoltmeterInput(ReadingEffect):
    """The voltmeter has a finite input resistance and a bias current.

    U = (U₀ + i R) R_in/(R_in + R) of a pair that unloaded shows U₀ behind the resistance R (Thévenin): that between
    its electrodes as the reading is taken, or with the driven pair held at the source's limit, R − R_md²/R_dd. Hardly
    seen on a sheet; a pair with an open lead, whose R is far beyond R_in, reads i R_in whatever is driven.

    Parameters
    ----------
    input_ohm : R_in, resistance between the terminals; 10 GΩ is chosen by us.
    bias_A : i, bias current out of the terminals.
    """

    class Options(PluginOptions):
        input_ohm: Annotated[float, Field(gt=0, le=1e15)] = 1e10
        bias_A: Annotated[float, Field(ge=-1e-3, le=1e-3)] = 0.0

    options: Options

    def read(self, moment: Moment, voltages: Array) -> Array:
        assert moment.measure_ohm is not None
        ohm = _behind(moment, voltages, moment.measure_ohm)
        input_ohm, bias_A = self.options.input_ohm, self.options.bias_A
        return (voltages + bias_A * ohm) * (input_ohm / (input_ohm + ohm))


def _behind(moment: Moment, voltages: Array, measure_ohm: Array) -> Array:
    """Resistance behind each reading while its pair is driven, (drives, measures)."""
    if moment.current_A is None or moment.drive_ohm is None:
        return measure_ohm
    limited = (moment.current_A < moment.setting.current_A) & (moment.drive_ohm > 0)
    mutual_ohm = voltages / moment.current_A  # nothing but the source has come before
    behind = measure_ohm - np.divide(mutual_ohm**2, moment.drive_ohm, out=np.zeros_like(voltages), where=limited)
    return np.maximum(behind, 0.0)
