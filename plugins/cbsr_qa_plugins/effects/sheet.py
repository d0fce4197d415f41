"""Effects of the sheet: unevenness by place, its answer to strain, and change with time and temperature."""

import math
from typing import Annotated, ClassVar, Final

import numpy as np
from pydantic import Field

from cbsr_qa.domain.numbers import Array
from cbsr_qa.plugin import (
    Moment,
    PluginOptions,
    RefusedError,
    Relaxation,
    SceneSetting,
    SheetDesign,
    SheetField,
    SheetOutline,
)
from cbsr_qa.simulate.effect import Positive, SceneEffect
from cbsr_qa.simulate.ramps import Transients, quasi_static
from cbsr_qa.simulate.streams import RandomStream

_LATTICE: Final = 41  # places a side
_WAVES: Final = 400  # their sum is Gaussian to a kurtosis of 3 − 1.5/400


def draw_field(stream: RandomStream, correlation_mm: float, index: int = 0) -> SheetField:
    """Draw a Gaussian field of variance one with the covariance exp(−d²/2ℓ²).

    It is made of waves of random directions, lengths and phases (random Fourier features; Rahimi & Recht 2007): a
    function of place alone, whatever the mesh. The stream's numbers of an index are used.
    """
    random = stream.generator(index)
    waves = random.standard_normal((_WAVES, 2)) / correlation_mm
    phases = random.uniform(0, 2 * np.pi, _WAVES)

    def field(places_mm: Array) -> Array:
        values: Array = np.sqrt(2 / _WAVES) * np.cos(places_mm @ waves.T + phases).sum(axis=1)
        return values

    return field


def smooth_factor(field: SheetField, *, deviation: float, over_mm: Array) -> SheetField:
    """Return a positive factor whose logarithm is a Gaussian field, one on average over some places.

    Parameters
    ----------
    field : Gaussian field of variance one.
    deviation : standard deviation of the factor over its mean, before it is divided by what is alike over all places.
    over_mm : (n, 2) places, evenly spread over the sheet, whose mean factor is one.
    """
    spread = float(np.sqrt(np.log1p(deviation**2)))  # of the logarithm, for that deviation of the factor

    def raw(places_mm: Array) -> Array:
        factor: Array = np.exp(spread * field(places_mm))
        return factor

    mean = float(raw(over_mm).mean())
    return lambda places_mm: raw(places_mm) / mean


def places_on(outline: SheetOutline) -> Array:
    """Places on a square lattice over a sheet, (n, 2) [mm]."""
    low_x, high_x, low_y, high_y = outline.extent_mm
    x, y = (np.linspace(low, high, _LATTICE) for low, high in ((low_x, high_x), (low_y, high_y)))
    places = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    return places[outline.clearance_mm(places) >= 0]


class UnevenSheet(SceneEffect):
    """An effect that multiplies one quantity of the sheet by a smooth random factor with a mean of one.

    Drawn once per seed. Subclasses state the quantity.

    Parameters
    ----------
    deviation : standard deviation of the factor over its mean on an infinite sheet. The mean over the sheet is
    divided
        out: on a disc of 100 mm, 0.088 of 0.1 remain with a correlation length of 20 mm, 0.052 with 60 mm.
    correlation_mm : correlation length (Gaussian covariance).
    """

    class Options(PluginOptions):
        deviation: Annotated[float, Field(ge=0, le=1)]
        correlation_mm: Positive

    #: ``conductance``, ``response`` or ``thickness``
    quantity: ClassVar[str]
    perturbs = "sheet"
    options: Options

    def prepare(self, setting: SceneSetting) -> None:
        self._stream = RandomStream(setting.seed, f"uneven-{self.quantity}")

    def design(self, design: SheetDesign) -> None:
        factors: list[SheetField] = getattr(design, self.quantity)
        factors.append(
            smooth_factor(
                draw_field(self._stream, self.options.correlation_mm),
                deviation=self.options.deviation,
                over_mm=places_on(design.sensor_type.outline),
            )
        )


class UnevenConductance(UnevenSheet):
    """The conductance of the unloaded sheet varies from place to place.

    The mean inter-electrode resistance stays the material's.
    """

    quantity = "conductance"


class UnevenResponse(UnevenSheet):
    """The response of the conductance to strain varies from place to place."""

    quantity = "response"


class UnevenThickness(UnevenSheet):
    """The thickness varies from place to place: a thicker place conducts better and is strained less."""

    quantity = "thickness"


class BatchPattern(SceneEffect):
    """Sensors of one batch respond to strain alike: their maps share a pattern.

    The logarithm of the response is √ρ c + √(1 − ρ) d with two Gaussian fields: c is drawn once per batch, d once per
    seed. ρ is so the share of its variance that two sensors of a batch have in common.

    Parameters
    ----------
    rho : ρ, from 0 (nothing in common) to 1.
    batch : name of the batch, which the common pattern is drawn for.
    deviation, correlation_mm : as those of uneven-response.
    """

    class Options(PluginOptions):
        rho: Annotated[float, Field(ge=0, le=1)]
        batch: Annotated[str, Field(min_length=1, max_length=64)]
        deviation: Annotated[float, Field(ge=0, le=1)]
        correlation_mm: Positive

    perturbs = "sheet"
    options: Options

    def prepare(self, setting: SceneSetting) -> None:
        # Negative, so that no sensor's own seed is the same.
        batch_seed = -1 - int.from_bytes(self.options.batch.encode(), "big")
        self._streams = [RandomStream(seed, "batch-pattern") for seed in (batch_seed, setting.seed)]

    def design(self, design: SheetDesign) -> None:
        common, own = (draw_field(stream, self.options.correlation_mm) for stream in self._streams)
        rho = self.options.rho
        design.response.append(
            smooth_factor(
                lambda places_mm: np.sqrt(rho) * common(places_mm) + np.sqrt(1 - rho) * own(places_mm),
                deviation=self.options.deviation,
                over_mm=places_on(design.sensor_type.outline),
            )
        )


class Piezoresistivity(SceneEffect):
    """The conductance under the head follows the strain along the material's quasi-static line.

    Δρ/ρ₀ = α_ε ε + β_ε (paper Eq 2), with the material's α_ε and β_ε. The paper fits the line to held loads, but an
    unloaded sheet has no change. So β_ε fades in over the first contact (``CONTACT_STRAIN``).
    """

    perturbs = "response"
    memory_s = 0.0

    def prepare(self, setting: SceneSetting) -> None:
        self._line = setting.material.against_strain

    def apply(self, moment: Moment) -> None:
        for index, press in enumerate(moment.presses):
            moment.response[index] += quasi_static(self._line, press.strain_at(moment.time_s))


class _Transient(SceneEffect):
    """Adds a transient of every press: subclasses prepare it."""

    perturbs = "response"

    def _begin(self, transients: Transients) -> None:
        self._transients, self.memory_s = transients, transients.memory_s

    def apply(self, moment: Moment) -> None:
        for index, press in enumerate(moment.presses):
            moment.response[index] += self._transients.change_at(press, moment.time_s)


class ConductanceRelaxation(_Transient):
    """The conductance relaxes with two exponentials after every press and every release.

    Paper Eq 3, superposed over all ramps. The response to every ramp of the quasi-static change q(t) is K(t) = 1 + w₁
    e^(−t/τ₁) + w₂ e^(−t/τ₂), with the material's loading kernel when the head presses harder and its unloading kernel
    when it lifts: Δρ/ρ₀(t) = Σ over ramps ∫ K(t − s) q̇(s) ds. Piezoresistivity is the 1 of K; this effect adds the
    rest. With negative weights the change creeps towards the steady state; after a release a residue remains, which
    fades while later loads press (paper 4.2).

    Departure from linear viscoelasticity: two kernels, because the paper finds unloading slower than loading.
    """

    needs: tuple[str, ...] = ("piezoresistivity",)

    def prepare(self, setting: SceneSetting) -> None:
        material = setting.material
        self._begin(Transients(material.loading_relaxation, material.unloading_relaxation, material.against_strain))


class Residue(_Transient):
    """A share of every released change remains and fades over minutes.

    Residues of earlier loads (paper 4.2), in addition to the material's relaxation: ramps that lift add the response
    −share e^(−t/τ).

    Parameters
    ----------
    share : share of the released change.
    decay_s : τ, minutes or more.
    """

    class Options(PluginOptions):
        share: Annotated[float, Field(ge=0, le=1)]
        decay_s: Positive

    needs: tuple[str, ...] = ("piezoresistivity",)
    options: Options

    def prepare(self, setting: SceneSetting) -> None:
        decay_s = self.options.decay_s
        kernel = Relaxation((-self.options.share, 0.0), (decay_s, decay_s), "scene")
        self._begin(Transients(None, kernel, setting.material.against_strain))


class UnloadingSpike(_Transient):
    """A release first raises the change for a short time before it falls.

    Paper 3.1.2. At the moment of a release the material's unloading kernel keeps −Σ w of the released change
    (`conductance-relaxation`). Every ramp that lifts adds the response −(1 + size + Σ w) e^(−t/τ): the change rises
    at once by `size` of the ramp, and returns to the material's own curve with τ. The paper prints neither number.

    Parameters
    ----------
    size : height of the spike over the released change.
    decay_s : τ, decay time of the spike.
    """

    class Options(PluginOptions):
        size: Annotated[float, Field(ge=0, le=2)]
        decay_s: Positive

    needs: tuple[str, ...] = ("piezoresistivity", "conductance-relaxation")
    options: Options

    def prepare(self, setting: SceneSetting) -> None:
        decay_s = self.options.decay_s
        unrelaxed = -sum(setting.material.unloading_relaxation.weights)
        kernel = Relaxation((unrelaxed - 1 - self.options.size, 0.0), (decay_s, decay_s), "scene")
        self._begin(Transients(None, kernel, setting.material.against_strain))


class Hysteresis(SceneEffect):
    """Once a press lifts, the response is larger than on the way in, until it is as deep again.

    On the way back from the deepest strain ε_m of the press the change at a strain ε is larger by
    4 width α ε_m x (1 − x), x = ε/ε_m: rate-independent, closed at both ends, widest half-way.

    Parameters
    ----------
    width : width of the loop over the change at its tip.
    """

    class Options(PluginOptions):
        width: Annotated[float, Field(ge=0, le=0.5)]

    needs: tuple[str, ...] = ("piezoresistivity",)
    perturbs = "response"
    memory_s = 0.0
    options: Options

    def prepare(self, setting: SceneSetting) -> None:
        self._slope = setting.material.against_strain.slope.value

    def apply(self, moment: Moment) -> None:
        for index, press in enumerate(moment.presses):
            strain = press.strain_at(moment.time_s)
            if strain > 0:  # closed at the loop's lower end
                # Largest strain up to a time: at the end of a ramp, or now.
                ends = [step.start_s + step.ramp_s for step in press.steps]
                deepest = max(
                    [press.strain_at(end) for end in ends if end <= moment.time_s] + [press.strain_at(moment.time_s)]
                )
                share = min(strain / deepest, 1.0)
                moment.response[index] += 4 * self.options.width * self._slope * deepest * share * (1 - share)


class TemperatureDrift(SceneEffect):
    """The conductance of sheet and contacts follows a temperature that drifts and swings.

    Factor 1 + c ΔT, ΔT(t) = rate t + swing sin(2π t/period).

    Parameters
    ----------
    coefficient_per_K : c, relative change of conductance per kelvin.
    rate_K_per_h : rate of warming.
    swing_K, period_s : amplitude and period of the swing, e.g. of air conditioning.
    """

    class Options(PluginOptions):
        coefficient_per_K: Annotated[float, Field(ge=-0.05, le=0.05)]
        rate_K_per_h: Annotated[float, Field(ge=-20, le=20)] = 0.0
        swing_K: Annotated[float, Field(ge=0, le=10)] = 0.0
        period_s: Positive = 1200.0

    perturbs = "impedance"
    options: Options

    def apply(self, moment: Moment) -> None:
        if moment.impedance_ohm is not None:
            options = self.options
            warmer_K = options.rate_K_per_h / 3600 * moment.run_s
            warmer_K += options.swing_K * math.sin(2 * math.pi * moment.run_s / options.period_s)
            factor = 1 + options.coefficient_per_K * warmer_K
            if factor <= 0:
                raise RefusedError(
                    f"temperature-drift leaves no conductance at {moment.run_s:g} s, {warmer_K:g} K from the start",
                    remedy="take a smaller coefficient_per_K, rate_K_per_h or swing_K",
                )
            moment.impedance_ohm = moment.impedance_ohm / factor
