"""Effects of stress and load cell: elastic stress, confinement, relaxation, noise, and a cell that ends."""

from cbsr_qa.plugin import Moment, PluginOptions, SceneSetting
from cbsr_qa.simulate.effect import Amount, Positive, SceneEffect
from cbsr_qa.simulate.ramps import Transients
from cbsr_qa.simulate.streams import RandomStream


class ElasticStress(SceneEffect):
    """The stress under the head is proportional to the strain, by the material's relaxed modulus.

    σ = E ε: uniaxial compression, no confinement under the head.
    """

    perturbs = "stress"

    def prepare(self, setting: SceneSetting) -> None:
        self._modulus_kPa = setting.material.modulus_kPa.value

    def apply(self, moment: Moment) -> None:
        for index, press in enumerate(moment.presses):
            moment.stress_kPa[index] += self._modulus_kPa * press.strain_at(moment.time_s)


class Confinement(SceneEffect):
    """A thin sheet that cannot bulge under a wide head is stiffer: all stress is multiplied by a factor.

    1 + 2 S² with S = r/(2 t) for a bonded layer (Gent & Lindley 1959): 2.3 for 13 mm on 4 mm.

    Parameters
    ----------
    factor : used instead of 1 + 2 S².
    """

    class Options(PluginOptions):
        factor: Positive | None = None

    needs: tuple[str, ...] = ("elastic-stress",)
    after: tuple[str, ...] = ("stress-relaxation",)
    perturbs = "stress"
    options: Options

    def prepare(self, setting: SceneSetting) -> None:
        shape, factor = setting.indenter.radius_mm / (2 * setting.sensor_type.thickness_mm), self.options.factor
        self._factor = 1 + 2 * shape**2 if factor is None else factor

    def apply(self, moment: Moment) -> None:
        moment.stress_kPa = [self._factor * stress for stress in moment.stress_kPa]


class StressRelaxation(SceneEffect):
    """The stress under a held head relaxes by two exponentials: a generalised Maxwell body.

    σ(t) = E ∫ (1 + w₁ e^(−(t−s)/τ₁) + w₂ e^(−(t−s)/τ₂)) ε̇(s) ds (paper Eq 3 over its steady state). The elastic
    effect is the 1 of the kernel; this effect adds the rest. Right after a release the sheet would pull on a head
    that stuck to it; the head does not stick, so the world reads no negative stress.
    """

    needs: tuple[str, ...] = ("elastic-stress",)
    perturbs = "stress"

    def prepare(self, setting: SceneSetting) -> None:
        self._modulus_kPa = setting.material.modulus_kPa.value
        kernel = setting.material.stress_relaxation
        self._transients = Transients(kernel, kernel)

    def apply(self, moment: Moment) -> None:
        for index, press in enumerate(moment.presses):
            moment.stress_kPa[index] += self._modulus_kPa * self._transients.change_at(press, moment.time_s)


class LoadCellNoise(SceneEffect):
    """Independent Gaussian noise on every force sample.

    Parameters
    ----------
    rms_N : standard deviation.
    """

    class Options(PluginOptions):
        rms_N: Amount

    perturbs = "force"
    options: Options

    def prepare(self, setting: SceneSetting) -> None:
        self._stream = RandomStream(setting.seed, "load-cell-noise")

    def apply(self, moment: Moment) -> None:
        moment.force_N += self.options.rms_N * float(self._stream.normal(moment.index))


class LoadCellSaturation(SceneEffect):
    """Forces beyond the cell's limit read as the limit (the rig's ends at 749 g, 7.35 N).

    Parameters
    ----------
    limit_N : samples are limited to −limit to +limit.
    """

    class Options(PluginOptions):
        limit_N: Positive

    after: tuple[str, ...] = ("load-cell-noise",)
    perturbs = "force"
    options: Options

    def apply(self, moment: Moment) -> None:
        moment.force_N = min(max(moment.force_N, -self.options.limit_N), self.options.limit_N)
