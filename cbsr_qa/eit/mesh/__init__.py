"""Triangle meshes of sheets, generated or imported."""
