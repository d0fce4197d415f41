"""Which group the others are compared with: one with which something can be compared."""

from collections import Counter
from dataclasses import replace

from cbsr_qa.fleet.design import Design
from cbsr_qa.fleet.figures import BoolArray, named
from cbsr_qa.fleet.groups import Grouping, reference_rank
from cbsr_qa.fleet.terms import By, Terms


def referred_to(grouping: Grouping, design: Design, measured: BoolArray, terms: Terms) -> tuple[Grouping, list[str]]:
    """Put a group first that most others can be compared with, unless groups were named; and say so.

    Parameters
    ----------
    measured : (R,) whether a run has a value of anything.

    Returns
    -------
    Groups, the reference first, and what is to be said of the choice, in sentences.
    """
    part_of = _parts(grouping, design, measured)
    sizes = Counter(part_of.values())
    first = grouping.reference
    best = min(
        grouping.names,
        key=lambda name: (-sizes[part_of[name]], *reference_rank(name, len(grouping.tests[name]), terms.by)),
    )
    if sizes[part_of[best]] < 2 or sizes[part_of[best]] <= sizes[part_of[first]]:
        return grouping, []
    members = [name for name in grouping.names if part_of[name] == part_of[best]]
    if terms.groups:
        if sizes[part_of[first]] > 1:
            return grouping, []
        said = f"Nothing can be compared with {first}; {named(members)} can among themselves"
        return grouping, [f"{said}: --groups {','.join(members)}"]
    usual = "is the earliest" if terms.by is By.PERIOD else "has most sensors"
    said = f"The reference is {best}: {first} {usual}, and cannot be compared with {named(members)}"
    return replace(grouping, names=(best, *(name for name in sorted(grouping.names) if name != best))), [said]


def _parts(grouping: Grouping, design: Design, measured: BoolArray) -> dict[str, int]:
    """Group → the connected part it is in; one without a value is a part of its own."""
    alone = {name: -1 - place for place, name in enumerate(grouping.names)}
    known = measured[design.rows]
    if not known.any():
        return alone
    made = design.crossing.only(known)
    names, parts = (made.stations, made.station_parts) if design.of_stations else (made.groups, made.group_parts)
    return alone | dict(zip(names, parts.tolist(), strict=True))
