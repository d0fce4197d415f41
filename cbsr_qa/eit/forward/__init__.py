"""Complete electrode model: solution, local updates, derivatives, closed forms."""
