"""In which order a multiplexer steps through drive and measure pairs; frames are kept in one canonical order."""

from cbsr_qa.domain.errors import RefusedError
from cbsr_qa.domain.patterns import DrivePattern, Pairs

Order = tuple[tuple[int, int], ...]


def scan_order(pattern: DrivePattern, *, inner: str, current_skip: int = 0, voltage_skip: int = 0) -> Order:
    """Return the order of a firmware whose pairs are k and k + 1 + skip, beginning with electrode 0.

    Parameters
    ----------
    inner : ``"current"`` where the driven pair changes with every step, ``"voltage"`` where the measured one does.
    current_skip, voltage_skip : electrodes between the two of a pair.

    Returns
    -------
    (drive, measure) indices into the pattern, each combination once.

    Raises
    ------
    RefusedError
        If the firmware's pairs are not the pattern's.
    """
    drives = _indices("drive", pattern.drive, current_skip, pattern.electrode_count)
    measures = _indices("measure", pattern.measure, voltage_skip, pattern.electrode_count)
    if inner == "current":
        return tuple((drive, measure) for measure in measures for drive in drives)
    return tuple((drive, measure) for drive in drives for measure in measures)


def _indices(kind: str, pairs: Pairs, skip: int, count: int) -> tuple[int, ...]:
    stepped = [(k, (k + 1 + skip) % count) for k in range(count)]
    where = {pair: index for index, pair in enumerate(pairs)}
    odd = [pair for pair in stepped if pair not in where] or [pair for pair in pairs if pair not in set(stepped)]
    if odd:
        a, b = odd[0]
        whose = "not among the sensor type's" if odd[0] not in where else "of the sensor type, not among its own"
        raise RefusedError(
            f"it steps through the {kind} pairs 0-{1 + skip}, 1-{2 + skip} and so on; pair {a}-{b} is {whose}",
            remedy="the sensor type's pattern and the firmware's are to be the same",
        )
    return tuple(where[pair] for pair in stepped)
