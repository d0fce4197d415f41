"""How often the setting that ``cbsr-qa frontier --force-error`` chooses is worse than asked, on made-up sensors.

``python -m benchmarks.setting_choice`` draws settings of known mean force error, and sensors whose errors scatter
log-normally about it. Half of the scatter is common to all settings of a sensor. It compares the choice with the one
by one standard error of four sensors, without new ones.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain.errors import RefusedError
from cbsr_qa.studies.frontier.point import Accuracy, Point, TimeBasis
from cbsr_qa.studies.frontier.recommend import Target, recommend
from cbsr_qa.studies.frontier.setting import Setting
from cbsr_qa.studies.frontier.station import NEW_SEEDS, SEEDS

#: Standard deviation of the force error among sensors over its mean: 0.1 to 0.3 as simulated, 0.7 of the campaign.
SCATTERS = (0.15, 0.3, 0.6)
_SETTINGS = 12


@dataclass(frozen=True)
class Choices:
    """Numbers of choices that were made, and of those whose true mean is above the target."""

    made: int
    missed: int


def simulate_choices(scatter: float, trials: int) -> tuple[Choices, Choices]:
    """Choices by the command, and by one standard error of the sensors of the sweep."""
    random = np.random.default_rng([*b"choices", round(100 * scatter)])
    by_command, by_stderr = [], []
    for _ in range(trials):
        mean_N = 0.3 * np.linspace(1.0, 0.5, _SETTINGS) * np.exp(0.25 * random.standard_normal(_SETTINGS))
        target_N = float(np.exp(random.uniform(np.log(0.95 * mean_N.min()), np.log(np.median(mean_N)))))
        swept, new = _draw(mean_N, scatter, len(SEEDS), random), _draw(mean_N, scatter, len(NEW_SEEDS), random)
        tried = [(Setting(3 + number), _point(number, forces)) for number, forces in enumerate(swept.T)]
        confirmed = {Setting(3 + number): _point(number, forces) for number, forces in enumerate(new.T)}
        try:
            way = recommend(tried, Target(target_N), paper=None, confirm=confirmed.__getitem__).way
        except RefusedError:
            way = None
        if way is not None:
            by_command.append(mean_N[way.places - 3] > target_N)
        stderr_N = swept.std(axis=0, ddof=1) / np.sqrt(len(SEEDS))
        sufficient = np.flatnonzero(swept.mean(axis=0) + stderr_N <= target_N)
        by_stderr += [mean_N[sufficient[0]] > target_N] if sufficient.size else []
    command, stderr = (Choices(len(each), int(np.sum(each))) for each in (by_command, by_stderr))
    return command, stderr


def _draw(
    mean_N: NDArray[np.float64], scatter: float, sensors: int, random: np.random.Generator
) -> NDArray[np.float64]:
    """Force errors (sensors, settings)."""
    width = np.sqrt(np.log(1 + scatter**2))
    common, own = random.standard_normal((sensors, 1)), random.standard_normal((sensors, len(mean_N)))
    return np.asarray(mean_N * np.exp(width * (common + own) / np.sqrt(2) - width**2 / 2), dtype=np.float64)


def _point(number: int, forces_N: NDArray[np.float64]) -> Point:
    accuracy = {"force_error": Accuracy.from_sensors(forces_N.tolist(), "N")}
    return Point(TimeBasis.STATION, "made up", {}, accuracy, None, 600.0 + number, len(forces_N))


def main() -> None:
    for scatter in SCATTERS:
        command, stderr = simulate_choices(scatter, 4000)
        print(
            f"scatter {scatter:.0%}: {command.missed / command.made:.1%} of {command.made} choices miss the target;"
            f" by one standard error of {len(SEEDS)} sensors {stderr.missed / stderr.made:.1%} of {stderr.made}"
        )


if __name__ == "__main__":
    main()
