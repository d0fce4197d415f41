"""Calibration certificates: issued, verified, replaced and revoked."""
