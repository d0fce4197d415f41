"""SQLAlchemy tables and the repository: the only place that speaks to a database."""
