"""Designs of runs for tests of the mixed model: batches, sensors and stations with known truth."""

from dataclasses import dataclass

import numpy as np

from cbsr_qa.stats.crossings import Crossing, crossing


@dataclass(frozen=True)
class Fleet:
    """A design with the numbers of each run's batch, station and sensor."""

    batch: np.ndarray
    station: np.ndarray
    sensor: np.ndarray

    @property
    def design(self) -> Crossing:
        names = ([f"{letter}{number:03d}" for number in column] for letter, column in self.columns)
        return crossing(*names)

    @property
    def columns(self):
        return ("b", self.batch), ("s", self.station), ("n", self.sensor)

    def values(self, random, *, batches, stations, sensor=1.0, run=0.3):
        """Draw one value a run: offsets of batches and stations, deviations of sensor and run."""
        drawn = sensor * random.normal(size=self.sensor.max() + 1)[self.sensor]
        fixed = np.asarray(batches)[self.batch] + np.asarray(stations)[self.station]
        return fixed + drawn + run * random.normal(size=len(self.sensor))


def fleet(rows) -> Fleet:
    """Return the design of rows (batch, station, sensor)."""
    return Fleet(*np.array(rows).T)


def three_batches(*, on_all: bool, home: int = 12) -> Fleet:
    """3 batches × 20 sensors × 3 stations: ``home`` of a batch's sensors on its own station, the rest on the others.

    So stations and batches are much confounded. With ``on_all`` every third sensor runs on all stations.
    """
    rows = []
    for batch in range(3):
        homes = [batch] * home + [(batch + 1 + index % 2) % 3 for index in range(20 - home)]
        for index in range(20):
            station = homes[(7 * index) % 20]
            stations = range(3) if on_all and index % 3 == 0 else [station]
            rows += [(batch, one, 20 * batch + index) for one in stations]
    return fleet(rows)


def uneven(random, sensors=24, batches=3, stations=3) -> Fleet:
    """Sensors with one to four runs on stations by chance, repeats on one station among them."""
    rows = []
    for sensor in range(sensors):
        for _ in range(random.integers(1, 5)):
            rows.append((sensor % batches, random.integers(0, stations), sensor))
    return fleet(rows)
