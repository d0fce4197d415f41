"""The device under test: sensor type, electrodes, drive pattern, mesh."""
