"""Instruments that are not there, over real byte streams: the station's own drivers talk to them unchanged."""
