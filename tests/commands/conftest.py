"""Tests of this room open many databases and run many commands in one process."""

from shared_statements import share_statements

share_statements()
