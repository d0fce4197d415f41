"""One function per use case; the only place where things are put together."""
