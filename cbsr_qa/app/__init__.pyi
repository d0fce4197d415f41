from .apply import (
    ApplyRequest as ApplyRequest,
    applied_document as applied_document,
    apply_calibration as apply_calibration,
    as_csv as as_csv,
    write_table as write_table,
)
from .calibration_file import (
    export_calibration as export_calibration,
    read_any as read_any,
    show_calibration as show_calibration,
    verify_file as verify_file,
)
from .changes import list_changes as list_changes, override_verdict as override_verdict
from .database import (
    database_status as database_status,
    state_words as state_words,
    upgrade_database as upgrade_database,
)
from .export import export_run as export_run
