"""Use cases: one function each."""

from typing import TYPE_CHECKING

from cbsr_qa.lazy import door

if TYPE_CHECKING:
    from .archive import Archived as Archived, archive_runs as archive_runs, unarchive_runs as unarchive_runs
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
    from .sync import (
        Synchronised as Synchronised,
        decide_item as decide_item,
        keep_synchronised as keep_synchronised,
        sync_status as sync_status,
        synchronise as synchronise,
    )

door(__name__, __file__)
