"""Readings of a sheet under loads, without a mesh for the loads."""
