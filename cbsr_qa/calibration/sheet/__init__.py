"""Properties of one sheet: response map, baseline, characteristic, data sheet."""
