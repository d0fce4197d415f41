"""Triangle meshes of sheets, generated or imported."""

from typing import TYPE_CHECKING

from cbsr_qa.lazy import door

if TYPE_CHECKING:
    from .files import mesh_sensor as mesh_sensor, read_mesh as read_mesh, write_mesh as write_mesh
    from .imported import ElectrodeAt as ElectrodeAt, import_mesh as import_mesh
    from .sheet import image_mesh as image_mesh, sheet_mesh as sheet_mesh
    from .triangulate import smallest_angle_deg as smallest_angle_deg

door(__name__, __file__)
