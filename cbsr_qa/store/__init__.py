"""The database: tables, journal, results, and their chain of digests."""
