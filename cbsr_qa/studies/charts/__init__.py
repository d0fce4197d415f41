"""Control charts of a station."""
