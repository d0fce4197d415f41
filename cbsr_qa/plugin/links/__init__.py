"""How drivers reach their instruments; every failure is an InstrumentError."""
