"""What is to be kept in mind of a whole comparison: runs left out, mixtures, clocks, and groups that say little."""

from collections import Counter
from collections.abc import Sequence
from datetime import datetime

from cbsr_qa.domain.fleet import FleetRun
from cbsr_qa.fleet.clocks import clock_warnings
from cbsr_qa.fleet.design import NO_BATCH, Design
from cbsr_qa.fleet.figures import named
from cbsr_qa.fleet.groups import Grouping, software_words
from cbsr_qa.fleet.terms import By, Terms
from cbsr_qa.report.numbers import plural


def cautions(
    members: Sequence[FleetRun], grouping: Grouping, design: Design, terms: Terms, now: datetime
) -> Sequence[str]:
    """Return what is to be kept in mind, in sentences.

    Parameters
    ----------
    members : the runs that count.
    now : by the computer's clock.
    """
    said = [
        plural(count, f"run {one} and is left out", f"runs {many} and are left out")
        for (one, many), count in sorted(grouping.left_out.items())
    ]
    said += _groups_warnings(members, grouping, terms)
    said += _shared_batches(grouping, design)
    for noun, names in (
        ("recipes", [run.recipe for run in members]),
        ("software versions", [] if terms.by is By.SOFTWARE else software_words(members)),
        ("simulated and real benches", ["simulated" if run.simulated else "real" for run in members]),
    ):
        counts = Counter(names)
        if len(counts) > 1:
            shares = "; ".join(f"{name}: {plural(count, 'run')}" for name, count in counts.most_common())
            said.append(f"mixed {noun} ({shares}): a difference of groups may be one of these")
    clocks = clock_warnings(members, now)
    said += clocks
    if clocks and terms.by is By.PERIOD:
        said.append(
            "periods are taken from those clocks: compare by batch, or leave those days out by --since, --until"
        )
    return [_begun(words, grouping.names) for words in said]


def _begun(words: str, names: Sequence[str]) -> str:
    """Begin with a capital what stands alone, unless it begins with a group's name, which is as it is."""
    return words if words.startswith(tuple(names)) else words[:1].upper() + words[1:]


def _groups_warnings(members: Sequence[FleetRun], grouping: Grouping, terms: Terms) -> Sequence[str]:
    said = []
    if len(grouping.names) == 1:
        said.append(f"there is one {terms.by} only, {grouping.reference}: it is described, and compared with nothing")
    said += [
        f"{name} has one sensor only, which says nothing of how sensors differ"
        for name in grouping.names
        if len(grouping.tests[name]) == 1
    ]
    owners = Counter(serial for name in grouping.names for serial in grouping.tests[name])
    several = sorted(serial for serial, count in owners.items() if count > 1)
    if several and terms.by in (By.BATCH, By.MATERIAL):
        said.append(
            f"runs put {plural(len(several), 'sensor')} into several groups, which is a mistake in one of them: "
            f"{named(several)}"
        )
    if terms.by is By.MATERIAL:
        said += _nested(members, grouping)
    return said


def _shared_batches(grouping: Grouping, design: Design) -> Sequence[str]:
    """Say on which batches differences of periods or software versions rest."""
    if not design.levels:
        return []
    shared = {name: design.shared(name, grouping.reference) for name in grouping.names[1:]}
    told = named([f"{name} (batch {named(batches)})" for name, batches in shared.items() if batches])
    if not told:
        return []
    return [
        "every batch at every station is a level of its own in the model, so that no batch is taken for a "
        f"{design.noun}: differences from {grouping.reference} rest on batches that ran at one station in both, and "
        f"those are with {told}"
    ]


def _nested(members: Sequence[FleetRun], grouping: Grouping) -> Sequence[str]:
    batches: dict[str, set[str]] = {name: set() for name in grouping.names}
    for run in members:
        if run.material in batches:
            batches[run.material].add(run.batch or NO_BATCH)
    single = [name for name in grouping.names if len(batches[name]) == 1]
    if not single:
        return ["batches of one material are taken for alike: how they differ is not in the intervals"]
    listed = ", ".join(f"{name} is batch {next(iter(batches[name]))} only" for name in single)
    return [f"{listed}: a difference of materials cannot be told from one of batches"]
