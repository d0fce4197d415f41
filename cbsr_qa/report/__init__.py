"""Report figures and rendering."""
