"""Verification of many runs at once: the rows a comparison reads against their links."""

from array import array
from collections import defaultdict
from collections.abc import Iterator, Sequence
from itertools import repeat
from typing import Any, Final, NamedTuple

import numpy as np
from sqlalchemy import ColumnElement, Connection, Double, Executable, Select, Text, select, type_coerce
from sqlalchemy.orm import aliased

from cbsr_qa.store.chain.check import check_run
from cbsr_qa.store.chain.links import key_id_of, link_digest, match_few_links, signing_key
from cbsr_qa.store.chain.run_documents import FIGURES, contents, words
from cbsr_qa.store.tables.records import LinkRow
from cbsr_qa.store.tables.results import AnalysisRow, MeasurementRow
from cbsr_qa.store.tables.runs import RunRow

#: Rows requested from a server at once.
AT_ONCE: Final = 2_000
#: Rows built at once: few enough for their memory to be reused while it is in the processor's cache, which takes two
#: thirds of the time of 2000.
_ROWS_AT_ONCE: Final = 200
#: Analyses that are read a second time at once.
_REREAD_ANALYSES: Final = 500


class Known(NamedTuple):
    """An analysis whose link is known; ``facts`` are what the link covers beside the measurements."""

    run: str
    analysis: str
    facts: str


class Figures:
    """Measurements as columns: analysis (−1: not requested), attributes, value.

    Repeated words are stored once: each row holds an index into ``descriptions``.
    """

    def __init__(self, connection: Connection, query: Executable, places: dict[str, int]) -> None:
        """Fetch analysis, value, joined words, lower and upper limit; whole columns at a time."""
        run, description_indexes, value = array("i"), array("i"), array("d")
        descriptions: defaultdict[tuple[Any, ...], int] = defaultdict()
        descriptions.default_factory = descriptions.__len__
        rows = connection.execute(query.execution_options(stream_results=True, max_row_buffer=AT_ONCE))
        for block in rows.partitions(_ROWS_AT_ONCE):
            analysis, number, *description = zip(*block, strict=True)
            run.extend(map(places.get, analysis, repeat(-1)))
            description_indexes.extend(map(descriptions.__getitem__, zip(*description, strict=True)))
            value.frombytes(np.array(number, dtype=np.float64).tobytes())
        self.descriptions = list(descriptions)
        # Earlier analyses of a run, and those stored during this read, are left out.
        places_of = np.array(run, dtype=np.int32)
        listed = places_of >= 0
        self.place, self.description_index = places_of[listed], np.array(description_indexes, dtype=np.int32)[listed]
        self.value = np.array(value, dtype=np.float64)[listed]


def figures_query() -> Select[*tuple[Any, ...]]:
    """Query analysis, value, joined words, lower and upper limit of measurements, types of cells not checked."""
    m = MeasurementRow
    numbers = [type_coerce(column, Double) for column in (m.value, m.lower_limit, m.upper_limit)]
    return select(type_coerce(m.analysis, Text), numbers[0], type_coerce(words(), Text), *numbers[1:])


def check_figures(
    connection: Connection,
    chosen: Sequence[ColumnElement[bool]],
    known: Sequence[Known | None],
    figures: Figures,
) -> None:
    """Check rows read from runs against their chains.

    Parameters
    ----------
    chosen : conditions that select runs; empty for all.
    known : of every analysis in ``figures``; None where a run is unchained or was never analysed.
    figures : every measurement of these analyses.

    Raises
    ------
    StoreError
        If a row was altered: the message names table and row.
    """
    linked = _read_links(connection, chosen)
    unlike = _find_unlike(known, figures, linked)
    m = MeasurementRow
    for first in range(0, len(unlike), _REREAD_ANALYSES):
        batch = unlike[first : first + _REREAD_ANALYSES]
        places = {known_analysis.analysis: place for place, known_analysis in enumerate(batch)}
        # PostgreSQL fills gaps, so that rows of an analysis may come in another order than they were stored in.
        in_order = figures_query().where(m.analysis.in_(list(places))).order_by(m.analysis, m.number)
        for altered in _find_unlike(batch, Figures(connection, in_order, places), linked):
            check_run(connection, altered.run)  # raises, naming the row


def _find_unlike(known: Sequence[Known | None], figures: Figures, linked: dict[str, tuple[str, str]]) -> list[Known]:
    texts = ["" if analysis is None else analysis.facts for analysis in known]
    digests = contents(texts, figures.place, figures.description_index, figures.value, figures.descriptions)
    return [
        analysis
        for analysis, content in zip(known, digests, strict=True)
        if analysis is not None and linked.get(analysis.analysis) != (analysis.run, content)
    ]


def _read_links(connection: Connection, chosen: Sequence[ColumnElement[bool]]) -> dict[str, tuple[str, str]]:
    """Return analysis → run and content digest of every link that matches its predecessor and signature."""
    link, before, a = LinkRow, aliased(LinkRow), AnalysisRow
    query = (
        select(a.analysis, RunRow.run, RunRow.chain, link.content_sha256, link.sha256, link.mac, before.sha256)
        .join(RunRow, RunRow.run == a.run)
        .join(link, (link.run == a.run) & (link.kind == FIGURES) & (link.document == a.analysis))
        .join(before, (before.run == link.run) & (before.number == link.number - 1))
        .where(*chosen, match_few_links())
    )
    rows = connection.execute(query.execution_options(yield_per=AT_ONCE))
    return dict(_following(connection, rows))


def _following(connection: Connection, rows: Any) -> Iterator[tuple[str, tuple[str, str]]]:
    key = signing_key(connection)
    for analysis, run, chain, content, own, mac, before in rows:
        key_id = key_id_of(chain or "")
        signed = key is None or key.key_id != key_id or (mac is not None and key.verify(run, own, mac))
        if signed and link_digest(before, FIGURES, analysis, content) == own:
            yield analysis, (run, content)
