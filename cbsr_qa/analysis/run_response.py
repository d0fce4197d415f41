"""Which way the conductance goes under load: a property of the material, decided from its loads where not given."""

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain.footprints import Footprint
from cbsr_qa.domain.mesh import Mesh
from cbsr_qa.domain.sensor import Response

#: A load votes only if its mean change under the head is this many noise floors: the floor is a maximum over
#: thousands of elements, so a third of it is already clear of the noise of a mean.
_VOTE = 1 / 3


def decide_response(
    configured: Response, signals: Iterable[float], noise_floor: float
) -> tuple[Response, str, tuple[str, ...]]:
    """Decide the sign of the response.

    Parameters
    ----------
    configured : of the sensor type.
    signals : mean relative change under the head, one per load.
    noise_floor : relative.

    Returns
    -------
    INCREASE or DECREASE, how it was decided, and warnings (loads that disagree, or none that says anything).
    """
    clear = [signal for signal in signals if abs(signal) > _VOTE * noise_floor]
    rising = sum(signal > 0 for signal in clear)
    falling = len(clear) - rising
    voted = Response.INCREASE if rising >= falling else Response.DECREASE
    counts = f"{rising} loads raise the conductance, {falling} lower it"
    if configured is not Response.AUTO:
        against = f"the sensor type says its response is {configured}, but {counts}"
        disagree = bool(clear) and voted is not configured
        return configured, "configured in the sensor type", (against,) if disagree else ()
    if not clear:
        return voted, "not decided: no load stands out of the noise", ("no load stands out of the noise",)
    warnings = (f"the loads disagree about the sign of the response: {counts}",) if rising and falling else ()
    return voted, f"decided from {len(clear)} loads: {counts}", warnings


def mean_under(mesh: Mesh, values: NDArray[np.float64], pressed: Footprint) -> float:
    """Area-weighted mean of an image over the elements whose centroid lies under a head.

    Parameters
    ----------
    values : (e,) float64.

    Returns
    -------
    float; 0 where the head covers no element's centroid.
    """
    under = pressed.contains(mesh.centroids_mm)
    area = mesh.areas_mm2 * under
    return float(values @ area / area.sum()) if under.any() else 0.0
