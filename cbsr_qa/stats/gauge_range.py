"""Crossed gauge R&R by averages and ranges (AIAG MSA 4th edition, chapter III): quick, and without intervals.

    EV = R̄ K₁,  AV² = (X̄_diff K₂)² − EV²/(p r),  PV = R_p K₃;   K₁ = 1/d₂(r),  K₂ = 1/d₂*(o),  K₃ = 1/d₂*(p)

R̄ is the mean range of repeated runs, X̄_diff the range of the stations' means, R_p that of the sensors'. It does not
see an interaction of sensors and stations.
"""

from dataclasses import dataclass

import numpy as np

from cbsr_qa.stats.gauge_study import Study, Variation, check_tolerance, clipped
from cbsr_qa.stats.range_constants import d2_d3, d2_star


@dataclass(frozen=True, slots=True)
class GaugeRange:
    """A study by averages and ranges: what was averaged, in the values' unit, and the components."""

    mean_range: float
    station_range: float
    sensor_range: float
    variation: Variation


def gauge_range(study: Study, *, tolerance: float | None = None) -> GaugeRange:
    """Return the components of a crossed study.

    Parameters
    ----------
    tolerance : width of the metric's limits, in its unit.

    Raises
    ------
    NumericsError
        A tolerance that is none.
    """
    check_tolerance(tolerance)
    p, o, r = study.shape
    mean_range = float(np.ptp(study.values, axis=2).mean())
    stations = float(np.ptp(study.values.mean(axis=(0, 2))))
    sensors = float(np.ptp(study.values.mean(axis=(1, 2))))
    repeatability = (mean_range / d2_d3(r)[0]) ** 2
    between = clipped((stations / d2_star(o, 1)) ** 2 - repeatability / (p * r))
    sensor = (sensors / d2_star(p, 1)) ** 2
    gauge = repeatability + between.value
    note = "stations differ no more than repeated runs do: reproducibility was set to zero"
    variation = Variation(
        repeatability=clipped(repeatability),
        reproducibility=between,
        gauge=clipped(gauge),
        sensor=clipped(sensor),
        total=clipped(gauge + sensor),
        tolerance=tolerance,
        notes=(note,) if between.estimate < 0 else (),
    )
    return GaugeRange(mean_range, stations, sensors, variation)
