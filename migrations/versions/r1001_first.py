"""The schema of version 0.1.0, the first that was released: all tables and indexes. No earlier schema is upgraded.

The environment creates the views. A later revision that only adds tables or nullable columns leaves ``sync_accepts``
alone. One after which rows of older senders would not fit, or would not match their digests, sets ``oldest_schema``
to itself.
"""

from typing import Final

from alembic import op

# Programs from before 0.1.0 counted their schemas from 0001 to 0024, and compare them as text.
revision = "1001"
down_revision = None
branch_labels = None
depends_on = None

#: Names of types, and options, that differ between databases.
_WORDS: Final = {
    "sqlite": {"real": "DOUBLE", "time": "DATETIME", "bytes": "BLOB", "without_rowid": " WITHOUT ROWID"},
    "postgresql": {
        "real": "DOUBLE PRECISION",
        "time": "TIMESTAMP WITH TIME ZONE",
        "bytes": "BYTEA",
        "without_rowid": "",
    },
}

#: In the order they refer to each other.
_STATEMENTS: Final = (
    """
    CREATE TABLE outbox (
        kind VARCHAR(32) NOT NULL, item VARCHAR(64) NOT NULL, version INTEGER NOT NULL, sent INTEGER NOT NULL,
        noted_at {time} NOT NULL, state VARCHAR(16) NOT NULL, why TEXT NOT NULL,
        CONSTRAINT pk_outbox PRIMARY KEY (kind, item))
    """,
    """
    CREATE TABLE releases (
        release_id VARCHAR(36) NOT NULL, kind VARCHAR(16) NOT NULL, name TEXT NOT NULL, sha256 VARCHAR(64) NOT NULL,
        outcome VARCHAR(16) NOT NULL, operator TEXT NOT NULL, why TEXT NOT NULL, noted_at {time} NOT NULL,
        CONSTRAINT pk_releases PRIMARY KEY (release_id))
    """,
    "CREATE INDEX ix_releases_sha256_release_id ON releases (sha256, release_id)",
    """
    CREATE TABLE runs_begun (
        number INTEGER NOT NULL, run VARCHAR(36) NOT NULL, sha256 {bytes} NOT NULL,
        CONSTRAINT pk_runs_begun PRIMARY KEY (number), CONSTRAINT uq_runs_begun_run UNIQUE (run)){without_rowid}
    """,
    """
    CREATE TABLE sensors (
        serial VARCHAR(64) NOT NULL, batch TEXT NOT NULL, sensor_type TEXT NOT NULL,
        CONSTRAINT pk_sensors PRIMARY KEY (serial))
    """,
    """
    CREATE TABLE sync_accepts (
        oldest_schema VARCHAR(32) NOT NULL,
        CONSTRAINT pk_sync_accepts PRIMARY KEY (oldest_schema))
    """,
    """
    CREATE TABLE sync_refusals (
        kind VARCHAR(32) NOT NULL, item VARCHAR(64) NOT NULL, station TEXT NOT NULL,
        station_sha256 VARCHAR(64) NOT NULL, centre_sha256 VARCHAR(64) NOT NULL, run VARCHAR(36), why TEXT NOT NULL,
        noted_at {time} NOT NULL,
        CONSTRAINT pk_sync_refusals PRIMARY KEY (kind, item, station, station_sha256, centre_sha256, noted_at))
    """,
    """
    CREATE TABLE sync_settlements (
        kind VARCHAR(32) NOT NULL, item VARCHAR(64) NOT NULL, settled_at {time} NOT NULL,
        CONSTRAINT pk_sync_settlements PRIMARY KEY (kind, item, settled_at))
    """,
    """
    CREATE TABLE runs (
        run VARCHAR(36) NOT NULL, serial VARCHAR(64) NOT NULL, batch TEXT NOT NULL, sensor_type TEXT NOT NULL,
        station TEXT NOT NULL, recipe TEXT NOT NULL, operator TEXT NOT NULL, started_at {time} NOT NULL,
        configuration TEXT NOT NULL, configuration_digest VARCHAR(64) NOT NULL, software JSON NOT NULL,
        simulated JSON NOT NULL, setting JSON NOT NULL, chain VARCHAR(64), before_run VARCHAR(36),
        before_link INTEGER, before_sha256 {bytes},
        CONSTRAINT pk_runs PRIMARY KEY (run),
        CONSTRAINT fk_runs_serial_sensors FOREIGN KEY(serial) REFERENCES sensors (serial))
    """,
    "CREATE INDEX ix_runs_batch ON runs (batch)",
    "CREATE INDEX ix_runs_before_run ON runs (before_run)",
    "CREATE INDEX ix_runs_serial_run ON runs (serial, run)",
    "CREATE INDEX ix_runs_started_at ON runs (started_at)",
    "CREATE INDEX ix_runs_station_run ON runs (station, run)",
    "CREATE INDEX ix_runs_station_started_at ON runs (station, started_at)",
    """
    CREATE TABLE analyses (
        analysis VARCHAR(36) NOT NULL, run VARCHAR(36) NOT NULL, analysed_at {time} NOT NULL,
        software JSON NOT NULL, outcome VARCHAR(16) NOT NULL, reason TEXT NOT NULL, calibration_why TEXT NOT NULL,
        noise_weighting VARCHAR(16) NOT NULL, weight_ratio {real}, compute_s JSON NOT NULL,
        CONSTRAINT pk_analyses PRIMARY KEY (analysis),
        CONSTRAINT fk_analyses_run_runs FOREIGN KEY(run) REFERENCES runs (run))
    """,
    "CREATE INDEX ix_analyses_run_analysis ON analyses (run, analysis)",
    """
    CREATE TABLE archives (
        run VARCHAR(36) NOT NULL, file TEXT NOT NULL, file_bytes INTEGER NOT NULL, file_sha256 {bytes} NOT NULL,
        archived_at {time} NOT NULL,
        CONSTRAINT pk_archives PRIMARY KEY (run),
        CONSTRAINT fk_archives_run_runs FOREIGN KEY(run) REFERENCES runs (run))
    """,
    """
    CREATE TABLE chart_references (
        reference VARCHAR(36) NOT NULL, station TEXT NOT NULL, recipe TEXT NOT NULL, golden TEXT NOT NULL,
        name VARCHAR(64) NOT NULL, phase TEXT NOT NULL, qualifier TEXT NOT NULL, location TEXT NOT NULL,
        unit TEXT NOT NULL, kind VARCHAR(16) NOT NULL, settings JSON NOT NULL, mean {real} NOT NULL,
        deviation {real} NOT NULL, runs INTEGER NOT NULL, first_run VARCHAR(36) NOT NULL,
        last_run VARCHAR(36) NOT NULL, operator TEXT NOT NULL, made_at {time} NOT NULL, why TEXT NOT NULL,
        CONSTRAINT pk_chart_references PRIMARY KEY (reference),
        CONSTRAINT fk_chart_references_first_run_runs FOREIGN KEY(first_run) REFERENCES runs (run),
        CONSTRAINT fk_chart_references_last_run_runs FOREIGN KEY(last_run) REFERENCES runs (run))
    """,
    "CREATE INDEX ix_chart_references_station_reference ON chart_references (station, reference)",
    """
    CREATE TABLE configuration_changes (
        run VARCHAR(36) NOT NULL, kind VARCHAR(16) NOT NULL, name TEXT NOT NULL, earlier_run VARCHAR(36) NOT NULL,
        old_sha256 VARCHAR(64) NOT NULL, new_sha256 VARCHAR(64) NOT NULL, differences JSON NOT NULL,
        operator TEXT NOT NULL, noted_at {time} NOT NULL, why TEXT NOT NULL,
        CONSTRAINT pk_configuration_changes PRIMARY KEY (run, kind),
        CONSTRAINT fk_configuration_changes_run_runs FOREIGN KEY(run) REFERENCES runs (run),
        CONSTRAINT fk_configuration_changes_earlier_run_runs FOREIGN KEY(earlier_run) REFERENCES runs (run))
    """,
    "CREATE INDEX ix_configuration_changes_kind_name ON configuration_changes (kind, name)",
    """
    CREATE TABLE gate_answers (
        run VARCHAR(36) NOT NULL, session INTEGER NOT NULL, subject VARCHAR(32) NOT NULL,
        policy VARCHAR(16) NOT NULL, outcome VARCHAR(16) NOT NULL, words TEXT NOT NULL, remedy TEXT NOT NULL,
        operator TEXT NOT NULL, why TEXT NOT NULL,
        CONSTRAINT pk_gate_answers PRIMARY KEY (run, session, subject),
        CONSTRAINT fk_gate_answers_run_runs FOREIGN KEY(run) REFERENCES runs (run))
    """,
    """
    CREATE TABLE instruments (
        run VARCHAR(36) NOT NULL, position INTEGER NOT NULL, role TEXT NOT NULL, driver TEXT NOT NULL,
        model TEXT NOT NULL, serial TEXT NOT NULL, firmware TEXT NOT NULL, simulated BOOLEAN NOT NULL,
        calibration_due TEXT, notes JSON,
        CONSTRAINT pk_instruments PRIMARY KEY (run, position),
        CONSTRAINT fk_instruments_run_runs FOREIGN KEY(run) REFERENCES runs (run))
    """,
    """
    CREATE TABLE phases (
        run VARCHAR(36) NOT NULL, phase INTEGER NOT NULL, name TEXT NOT NULL, sequence TEXT NOT NULL,
        role VARCHAR(16) NOT NULL, started_s {real} NOT NULL,
        CONSTRAINT pk_phases PRIMARY KEY (run, phase),
        CONSTRAINT fk_phases_run_runs FOREIGN KEY(run) REFERENCES runs (run))
    """,
    """
    CREATE TABLE reanalyses (
        reanalysis VARCHAR(36) NOT NULL, run VARCHAR(36) NOT NULL, key_sha256 VARCHAR(64) NOT NULL,
        recipe TEXT NOT NULL, analysed_at {time} NOT NULL, software JSON NOT NULL, outcome VARCHAR(16) NOT NULL,
        reason TEXT NOT NULL, noise_weighting VARCHAR(16) NOT NULL, weight_ratio {real}, compute_s JSON NOT NULL,
        warnings JSON NOT NULL, measurements JSON NOT NULL,
        CONSTRAINT pk_reanalyses PRIMARY KEY (reanalysis),
        CONSTRAINT fk_reanalyses_run_runs FOREIGN KEY(run) REFERENCES runs (run))
    """,
    "CREATE INDEX ix_reanalyses_run_key_sha256 ON reanalyses (run, key_sha256)",
    """
    CREATE TABLE run_links (
        run VARCHAR(36) NOT NULL, number INTEGER NOT NULL, kind VARCHAR(32) NOT NULL, document VARCHAR(64) NOT NULL,
        content_sha256 {bytes} NOT NULL, sha256 {bytes} NOT NULL, mac {bytes},
        CONSTRAINT pk_run_links PRIMARY KEY (run, number),
        CONSTRAINT fk_run_links_run_runs FOREIGN KEY(run) REFERENCES runs (run)){without_rowid}
    """,
    """
    CREATE UNIQUE INDEX ix_run_links_run_kind_document ON run_links (run, kind, document) WHERE kind NOT IN
        ('frame_blocks', 'sample_blocks', 'steps')
    """,
    """
    CREATE TABLE run_states (
        run VARCHAR(36) NOT NULL, number INTEGER NOT NULL, "end" TEXT NOT NULL, detail TEXT NOT NULL,
        time_s {real} NOT NULL, spent JSON NOT NULL, operator TEXT, software JSON, noted_at {time},
        CONSTRAINT pk_run_states PRIMARY KEY (run, number),
        CONSTRAINT fk_run_states_run_runs FOREIGN KEY(run) REFERENCES runs (run))
    """,
    """
    CREATE TABLE station_checks (
        check_id VARCHAR(36) NOT NULL, station TEXT NOT NULL, operator TEXT NOT NULL, checked_at {time} NOT NULL,
        sensor_type TEXT NOT NULL, configuration_digest VARCHAR(64) NOT NULL, software JSON NOT NULL,
        instruments JSON NOT NULL, outcome VARCHAR(16) NOT NULL, golden_run VARCHAR(36), seal TEXT,
        CONSTRAINT pk_station_checks PRIMARY KEY (check_id),
        CONSTRAINT fk_station_checks_golden_run_runs FOREIGN KEY(golden_run) REFERENCES runs (run))
    """,
    "CREATE INDEX ix_station_checks_station_check_id ON station_checks (station, check_id)",
    """
    CREATE TABLE adoptions (
        analysis VARCHAR(36) NOT NULL, reanalysis VARCHAR(36) NOT NULL, operator TEXT NOT NULL, why TEXT NOT NULL,
        adopted_at {time} NOT NULL,
        CONSTRAINT pk_adoptions PRIMARY KEY (analysis),
        CONSTRAINT fk_adoptions_analysis_analyses FOREIGN KEY(analysis) REFERENCES analyses (analysis),
        CONSTRAINT fk_adoptions_reanalysis_reanalyses FOREIGN KEY(reanalysis) REFERENCES reanalyses (reanalysis))
    """,
    """
    CREATE TABLE attendance (
        run VARCHAR(36) NOT NULL, phase INTEGER NOT NULL, entry INTEGER NOT NULL, kind VARCHAR(16) NOT NULL,
        prompt INTEGER, text TEXT NOT NULL, picture TEXT NOT NULL, "by" TEXT NOT NULL, time_s {real} NOT NULL,
        CONSTRAINT pk_attendance PRIMARY KEY (run, phase, entry),
        CONSTRAINT fk_attendance_run_phase_phases FOREIGN KEY(run, phase) REFERENCES phases (run, phase))
    """,
    """
    CREATE TABLE calibrations (
        calibration VARCHAR(36) NOT NULL, run VARCHAR(36) NOT NULL, analysis VARCHAR(36) NOT NULL,
        serial VARCHAR(64) NOT NULL, issued_at {time} NOT NULL, content_sha256 VARCHAR(64) NOT NULL,
        record_sha256 VARCHAR(64) NOT NULL, file {bytes} NOT NULL, file_sha256 VARCHAR(64) NOT NULL,
        CONSTRAINT pk_calibrations PRIMARY KEY (calibration),
        CONSTRAINT fk_calibrations_run_runs FOREIGN KEY(run) REFERENCES runs (run),
        CONSTRAINT fk_calibrations_analysis_analyses FOREIGN KEY(analysis) REFERENCES analyses (analysis),
        CONSTRAINT fk_calibrations_serial_sensors FOREIGN KEY(serial) REFERENCES sensors (serial))
    """,
    "CREATE INDEX ix_calibrations_run ON calibrations (run)",
    "CREATE INDEX ix_calibrations_serial_calibration ON calibrations (serial, calibration)",
    """
    CREATE TABLE frame_blocks (
        run VARCHAR(36) NOT NULL, phase INTEGER NOT NULL, block INTEGER NOT NULL, frames INTEGER NOT NULL,
        drives INTEGER NOT NULL, measures INTEGER NOT NULL, unit VARCHAR(16) NOT NULL, current_a {real},
        first_s {real} NOT NULL, last_s {real} NOT NULL, time_s {bytes} NOT NULL, voltages {bytes} NOT NULL,
        flags {bytes} NOT NULL, reading_time_s {bytes}, sha256 {bytes} NOT NULL,
        CONSTRAINT pk_frame_blocks PRIMARY KEY (run, phase, block),
        CONSTRAINT fk_frame_blocks_run_phase_phases FOREIGN KEY(run, phase) REFERENCES phases (run, phase))
    """,
    """
    CREATE TABLE loads (
        run VARCHAR(36) NOT NULL, phase INTEGER NOT NULL, load_index INTEGER NOT NULL, label TEXT NOT NULL,
        x_mm {real} NOT NULL, y_mm {real} NOT NULL, strain {real} NOT NULL, trial INTEGER NOT NULL,
        press_start_s {real} NOT NULL, hold_start_s {real} NOT NULL, release_start_s {real} NOT NULL,
        release_end_s {real} NOT NULL, rest_end_s {real} NOT NULL, clear_s {real}, eased JSON,
        CONSTRAINT pk_loads PRIMARY KEY (run, phase, load_index),
        CONSTRAINT fk_loads_run_phase_phases FOREIGN KEY(run, phase) REFERENCES phases (run, phase))
    """,
    """
    CREATE TABLE measurements (
        analysis VARCHAR(36) NOT NULL, number INTEGER NOT NULL, name VARCHAR(64) NOT NULL, value {real},
        unit TEXT NOT NULL, uncertainty {real}, phase TEXT NOT NULL, location TEXT NOT NULL, trial INTEGER,
        qualifier TEXT NOT NULL, how TEXT NOT NULL, bound VARCHAR(16) NOT NULL, load_index INTEGER, strain {real},
        outcome VARCHAR(16) NOT NULL, limited BOOLEAN NOT NULL, lower_limit {real}, upper_limit {real},
        marginal {real}, limit_phase TEXT, limit_qualifier TEXT,
        CONSTRAINT pk_measurements PRIMARY KEY (analysis, number),
        CONSTRAINT fk_measurements_analysis_analyses FOREIGN KEY(analysis) REFERENCES analyses (analysis))
    """,
    "CREATE INDEX ix_measurements_name ON measurements (name)",
    """
    CREATE TABLE phase_ends (
        run VARCHAR(36) NOT NULL, phase INTEGER NOT NULL, ended_s {real} NOT NULL,
        CONSTRAINT pk_phase_ends PRIMARY KEY (run, phase),
        CONSTRAINT fk_phase_ends_run_phase_phases FOREIGN KEY(run, phase)
        REFERENCES phases (run, phase)){without_rowid}
    """,
    """
    CREATE TABLE sample_blocks (
        run VARCHAR(36) NOT NULL, phase INTEGER NOT NULL, block INTEGER NOT NULL, channel TEXT NOT NULL,
        unit VARCHAR(16) NOT NULL, samples INTEGER NOT NULL, time_s {bytes} NOT NULL,
        sample_values {bytes} NOT NULL, sha256 {bytes} NOT NULL,
        CONSTRAINT pk_sample_blocks PRIMARY KEY (run, phase, block),
        CONSTRAINT fk_sample_blocks_run_phase_phases FOREIGN KEY(run, phase)
        REFERENCES phases (run, phase)){without_rowid}
    """,
    """
    CREATE TABLE station_check_frames (
        check_id VARCHAR(36) NOT NULL, resistances_ohm JSON NOT NULL, frames INTEGER NOT NULL,
        drives INTEGER NOT NULL, measures INTEGER NOT NULL, unit VARCHAR(16) NOT NULL, current_a {real},
        first_s {real} NOT NULL, last_s {real} NOT NULL, time_s {bytes} NOT NULL, voltages {bytes} NOT NULL,
        flags {bytes} NOT NULL, reading_time_s {bytes}, sha256 {bytes} NOT NULL,
        CONSTRAINT pk_station_check_frames PRIMARY KEY (check_id),
        CONSTRAINT fk_station_check_frames_check_id_station_checks FOREIGN KEY(check_id)
        REFERENCES station_checks (check_id))
    """,
    """
    CREATE TABLE station_check_lines (
        check_id VARCHAR(36) NOT NULL, number INTEGER NOT NULL, subject TEXT NOT NULL, name TEXT NOT NULL,
        outcome VARCHAR(16) NOT NULL, value {real}, unit TEXT NOT NULL, allowed TEXT NOT NULL, said TEXT NOT NULL,
        remedy TEXT NOT NULL,
        CONSTRAINT pk_station_check_lines PRIMARY KEY (check_id, number),
        CONSTRAINT fk_station_check_lines_check_id_station_checks FOREIGN KEY(check_id)
        REFERENCES station_checks (check_id))
    """,
    """
    CREATE TABLE steps (
        run VARCHAR(36) NOT NULL, phase INTEGER NOT NULL, entry INTEGER NOT NULL, number INTEGER NOT NULL,
        attempt INTEGER NOT NULL, step JSON NOT NULL, why TEXT NOT NULL, time_s {real},
        CONSTRAINT pk_steps PRIMARY KEY (run, phase, entry),
        CONSTRAINT fk_steps_run_phase_phases FOREIGN KEY(run, phase) REFERENCES phases (run, phase))
    """,
    """
    CREATE TABLE unloaded_marks (
        run VARCHAR(36) NOT NULL, phase INTEGER NOT NULL, mark INTEGER NOT NULL, time_s {real} NOT NULL,
        CONSTRAINT pk_unloaded_marks PRIMARY KEY (run, phase, mark),
        CONSTRAINT fk_unloaded_marks_run_phase_phases FOREIGN KEY(run, phase) REFERENCES phases (run, phase))
    """,
    """
    CREATE TABLE verdict_overrides (
        override_id VARCHAR(36) NOT NULL, run VARCHAR(36) NOT NULL, analysis VARCHAR(36) NOT NULL,
        outcome VARCHAR(16) NOT NULL, operator TEXT NOT NULL, why TEXT NOT NULL, noted_at {time} NOT NULL,
        CONSTRAINT pk_verdict_overrides PRIMARY KEY (override_id),
        CONSTRAINT fk_verdict_overrides_run_runs FOREIGN KEY(run) REFERENCES runs (run),
        CONSTRAINT fk_verdict_overrides_analysis_analyses FOREIGN KEY(analysis) REFERENCES analyses (analysis))
    """,
    "CREATE INDEX ix_verdict_overrides_run ON verdict_overrides (run)",
    """
    CREATE TABLE warnings (
        analysis VARCHAR(36) NOT NULL, number INTEGER NOT NULL, text TEXT NOT NULL,
        CONSTRAINT pk_warnings PRIMARY KEY (analysis, number),
        CONSTRAINT fk_warnings_analysis_analyses FOREIGN KEY(analysis) REFERENCES analyses (analysis))
    """,
    """
    CREATE TABLE calibration_baselines (
        calibration VARCHAR(36) NOT NULL, number INTEGER NOT NULL, location TEXT NOT NULL, x_mm {real} NOT NULL,
        y_mm {real} NOT NULL, value {real}, stderr {real}, loads INTEGER NOT NULL, why TEXT NOT NULL,
        CONSTRAINT pk_calibration_baselines PRIMARY KEY (calibration, number),
        CONSTRAINT fk_calibration_baselines_calibration_calibrations FOREIGN KEY(calibration)
        REFERENCES calibrations (calibration))
    """,
)


def upgrade() -> None:
    dialect = op.get_bind().dialect.name
    for statement in _STATEMENTS:
        op.execute(" ".join(statement.format(**_WORDS[dialect]).split()))  # SQLite keeps the text of an index
    op.execute(f"INSERT INTO sync_accepts (oldest_schema) VALUES ('{revision}')")
    if dialect == "postgresql":
        # HDF5 files do not get smaller: trying takes half of the time of storing a run.
        op.execute("ALTER TABLE calibrations ALTER COLUMN file SET STORAGE EXTERNAL")


def downgrade() -> None:
    for statement in reversed(_STATEMENTS):
        kind, name = statement.split()[1:3]
        if kind == "TABLE":
            op.drop_table(name)
