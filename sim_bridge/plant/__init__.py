"""Plant."""
