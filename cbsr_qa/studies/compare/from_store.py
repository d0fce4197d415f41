"""Batches, materials, stations, software versions or periods compared: from the store to a document and a page."""

import gc
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import date, datetime
from math import isfinite
from typing import Any

from cbsr_qa.config import database_url
from cbsr_qa.domain import RefusedError
from cbsr_qa.store import open_store
from cbsr_qa.studies.compare.comparison import Comparison, compare, unknown_metric
from cbsr_qa.studies.compare.document import document
from cbsr_qa.studies.compare.terms import Terms


@dataclass(frozen=True, slots=True)
class RunChoice:
    """Which stored runs are compared.

    Parameters
    ----------
    recipe : only its runs; None for all.
    since, until : first and last day a run began on, UTC.
    """

    recipe: str | None = None
    since: date | None = None
    until: date | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Compared:
    """A comparison that was made."""

    found: Comparison

    @property
    def exit_code(self) -> int:
        """0 where something could be compared, 3 where nothing could."""
        return 0 if self.found.compared else 3

    def document(self) -> dict[str, Any]:
        """Return it as one JSON document."""
        return document(self.found)


def compare_groups(choice: RunChoice, terms: Terms, *, database: str | None, now: datetime) -> Compared:
    """Compare groups of stored runs.

    Raises
    ------
    RefusedError
        If no run fits, or a recipe, group or metric that was named is not there (with the nearest name).
    StoreError
        If the database is missing or cannot be read.
    """
    if choice.since and choice.until and choice.since > choice.until:
        raise RefusedError(
            f"no day is after {choice.since} and before {choice.until}", remedy="swap --since and --until"
        )
    asked = (*terms.names, *terms.margins, *terms.detect)
    with _uncollected(), open_store(database_url(database), create=False) as store:
        known = store.metric_names() if asked else ()
        for name in asked:
            if name not in known:
                raise unknown_metric(name, known)
        names = tuple(dict.fromkeys(asked)) if terms.names else ()
        table = store.fleet(recipe=choice.recipe, since=choice.since, until=choice.until, names=names)
        return Compared(compare(table, terms, now))


@contextmanager
def _uncollected() -> Iterator[None]:
    """Search for no reference cycles meanwhile: a million values have none, and it takes a third of the time."""
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()


def read_groups(said: str | None) -> tuple[str, ...]:
    """Read ``A,B``: names of groups, the reference first; none where nothing was said.

    Raises
    ------
    RefusedError
        If a name is empty, or is there twice.
    """
    if said is None:
        return ()
    names = tuple(name.strip() for name in said.split(","))
    if not all(names):
        raise RefusedError(
            f"--groups {said[:80]!r} has an empty name",
            remedy="separate names by commas, for example --groups 41,42, or leave it out for all groups",
        )
    twice = [name for name in names if names.count(name) > 1]
    if twice:
        raise RefusedError(f"--groups names {twice[0][:64]!r} twice", remedy="name each group once")
    return names


def read_amounts(said: Sequence[str], option: str) -> dict[str, float]:
    """Read ``METRIC=VALUE`` pairs.

    Raises
    ------
    RefusedError
        If one is no such pair, its value is not a positive number, or its metric was named before.
    """
    found: dict[str, float] = {}
    for pair in said:
        name, equals, text = pair.rpartition("=")
        try:
            value = float(text)
        except ValueError:
            value = float("nan")
        if not (equals and name and isfinite(value) and value > 0):
            raise RefusedError(
                f"{option} {pair[:80]!r} is not METRIC=VALUE with a positive number",
                remedy=f"for example {option} centre_of_mass_error=0.5, in the metric's unit",
            )
        if name in found:
            raise RefusedError(f"{option} states {name[:64]!r} twice", remedy="state one value of each metric")
        found[name] = value
    return found
