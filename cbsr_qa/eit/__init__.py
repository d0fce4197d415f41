"""Electrical impedance tomography of sheets: forward model, loads, reconstruction, estimates, imaging."""
