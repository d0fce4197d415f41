"""Read-only views for people who query the database: the current state of runs, measurements and calibrations.

They are no part of a schema version: they are dropped before a migration, which may change the tables below them, and
created again at the latest version. The program itself reads tables.

A view compares nothing with the chains of the runs; a remark on it in the database says so.
"""

from typing import Final

from sqlalchemy import Connection, inspect, text

from cbsr_qa.store.runs.standing import up_to_date_sql
from cbsr_qa.store.tables.records import FEW_LINKS

_RUNS: Final = f"""
SELECT
    r.run, r.serial, r.batch, r.sensor_type, r.station, r.recipe, r.operator, r.started_at,
    COALESCE(s."end", 'running') AS state,
    s.detail AS state_detail,
    s.time_s AS station_s,
    CASE WHEN s."end" = 'finished' THEN COALESCE(o.outcome, a.outcome) END AS verdict,
    a.outcome, a.reason,
    o.operator AS overridden_by,
    o.why AS overridden_why,
    a.analysis, a.analysed_at,
    r.run IN (
        SELECT c.golden_run FROM station_checks AS c JOIN runs AS g ON g.run = c.golden_run AND g.station = c.station
    ) AS of_check,
    CAST(r.simulated AS TEXT) <> '[]' AS simulated
FROM runs AS r
LEFT JOIN run_states AS s
    ON s.run = r.run AND s.number = (SELECT max(x.number) FROM run_states AS x WHERE x.run = r.run)
LEFT JOIN analyses AS a
    ON a.run = r.run AND a.analysis = (
        SELECT max(x.analysis) FROM analyses AS x WHERE x.run = r.run AND {up_to_date_sql("x")}
    )
LEFT JOIN verdict_overrides AS o
    ON o.run = r.run AND o.override_id = (
        SELECT max(x.override_id) FROM verdict_overrides AS x WHERE x.run = r.run AND x.analysis = a.analysis
    )
"""

_MEASUREMENTS: Final = f"""
SELECT
    r.run, r.serial, r.batch, r.station, r.recipe, r.started_at, a.analysis,
    m.number, m.name, m.value, m.unit, m.uncertainty, m.bound,
    m.phase, m.location, m.trial, m.qualifier, m.load_index, m.strain,
    m.outcome, m.lower_limit, m.upper_limit, m.marginal, m.how
FROM runs AS r
JOIN analyses AS a
    ON a.run = r.run AND a.analysis = (
        SELECT max(x.analysis) FROM analyses AS x WHERE x.run = r.run AND {up_to_date_sql("x")}
    )
JOIN measurements AS m
    ON m.analysis = a.analysis
"""

#: Condition on a valid calibration: a row added without a link, or to a run of another sensor, is not valid.
#: A run whose chain was removed has no links, and any row of its sensor counts.
_ISSUED: Final = f"""{{run}}.run = {{row}}.run AND {{run}}.serial = {{row}}.serial AND (
        {{run}}.chain IS NULL OR EXISTS (
            SELECT 1 FROM run_links AS l
            WHERE l.run = {{row}}.run AND l.kind = 'calibrations' AND l.document = {{row}}.calibration
                AND l.{FEW_LINKS}
        )
    )"""

_CALIBRATIONS: Final = f"""
SELECT
    c.serial, c.calibration, c.run, r.batch, r.sensor_type, r.station, r.recipe, c.issued_at, r.verdict,
    c.content_sha256, c.file_sha256
FROM calibrations AS c
JOIN runs AS own
    ON {_ISSUED.format(run="own", row="c")}
JOIN v_runs AS r
    ON r.run = c.run
WHERE NOT EXISTS (
    SELECT 1 FROM calibrations AS later
    JOIN runs AS its
        ON {_ISSUED.format(run="its", row="later")}
    WHERE later.serial = c.serial AND later.calibration > c.calibration
)
"""

#: Remark in the database on each view: in its definition on SQLite, as its comment on PostgreSQL.
UNCHECKED: Final = (
    "Unchecked: rows as they are, not compared with the chains of the runs. Anyone who can write the tables can"
    " change what is shown here; cbsr-qa runs, export, report and db check notice it."
)

#: Name of each view and its query, the same on SQLite and PostgreSQL; a view may read those before it.
VIEWS: Final = {"v_runs": _RUNS, "v_measurements": _MEASUREMENTS, "v_calibrations": _CALIBRATIONS}


def create_views(connection: Connection) -> None:
    """Create all views, which must not exist."""
    for name, query in VIEWS.items():
        connection.execute(text(f"CREATE VIEW {name} AS /* {UNCHECKED} */ {query.strip()}"))
        if connection.dialect.name == "postgresql":
            connection.execute(text(f"COMMENT ON VIEW {name} IS '{UNCHECKED}'"))


def drop_views(connection: Connection) -> None:
    """Drop those views that exist."""
    for name in reversed(VIEWS):
        connection.execute(text(f"DROP VIEW IF EXISTS {name}"))


def views_missing(connection: Connection) -> bool:
    """Whether a view is missing, as after a later version took the database back to this schema."""
    return not set(VIEWS) <= set(inspect(connection).get_view_names())
