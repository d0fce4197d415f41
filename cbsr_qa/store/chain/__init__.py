"""The chain of digests of a run, and its verification."""
