"""Stored runs as files that other programs read: tables, frames, outcomes."""

from typing import TYPE_CHECKING

from cbsr_qa.lazy import door

if TYPE_CHECKING:
    from .export import (
        Exported as Exported,
        ExportRequest as ExportRequest,
        export_data as export_data,
        run_attributes as run_attributes,
    )
    from .formats import ExportTable as ExportTable
    from .frames import frames_of as frames_of, joined_samples as joined_samples, run_frames as run_frames
    from .netcdf import Variable as Variable, frame_variables as frame_variables
    from .tables import whole_table as whole_table

door(__name__, __file__)
