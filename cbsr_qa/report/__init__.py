"""From results and sections to pages."""
