"""Store and forward: what a station stored is sent to a central database."""
