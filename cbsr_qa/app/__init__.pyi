from .apply import (
    AppliedCalibration as AppliedCalibration,
    ApplyRequest as ApplyRequest,
    apply_calibration as apply_calibration,
    apply_outcome as apply_outcome,
    as_csv as as_csv,
    write_table as write_table,
)
from .apply_places import (
    AppliedPlaces as AppliedPlaces,
    apply_to_presses as apply_to_presses,
    of_presses as of_presses,
    places_csv as places_csv,
    places_outcome as places_outcome,
)
from .archive import Archived as Archived, archive_runs as archive_runs, unarchive_runs as unarchive_runs
from .calibrate import PressesCalibrated as PressesCalibrated, calibrate_from_presses as calibrate_from_presses
from .calibration_file import (
    Converted as Converted,
    export_calibration as export_calibration,
    read_any as read_any,
)
from .calibration_shown import ShownCalibration as ShownCalibration, show_calibration as show_calibration
from .calibration_signing import (
    NewKey as NewKey,
    SignedFile as SignedFile,
    SoundFile as SoundFile,
    make_key as make_key,
    sign_file as sign_file,
    verify_file as verify_file,
)
from .changes import (
    Changes as Changes,
    Overridden as Overridden,
    list_changes as list_changes,
    override_verdict as override_verdict,
)
from .command_hints import database_option as database_option, own_command as own_command
from .database import (
    DatabaseStatus as DatabaseStatus,
    Roles as Roles,
    Upgrade as Upgrade,
    database_roles as database_roles,
    database_status as database_status,
    upgrade_database as upgrade_database,
)
from .export import Exported as Exported, ExportRequest as ExportRequest, export_data as export_data
from .imaging import ImagedFrames as ImagedFrames, image_frames as image_frames, imaged_outcome as imaged_outcome
from .keeping import (
    Backup as Backup,
    DatabaseCheck as DatabaseCheck,
    Restored as Restored,
    back_up as back_up,
    check_database as check_database,
    restore_backup as restore_backup,
)
from .press_calibration_shown import ShownPressCalibration as ShownPressCalibration
from .sync import (
    Synchronised as Synchronised,
    decide_item as decide_item,
    keep_synchronised as keep_synchronised,
    sync_status as sync_status,
    synchronise as synchronise,
)
