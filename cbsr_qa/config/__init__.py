"""Station, recipe, sensor type, material and scene files: TOML to pydantic to domain."""
