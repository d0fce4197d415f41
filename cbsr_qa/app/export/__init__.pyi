from .export import (
    Exported as Exported,
    ExportRequest as ExportRequest,
    export_data as export_data,
)
