"""How drivers reach their instruments: byte streams whose every failure is an InstrumentError that names the role."""
