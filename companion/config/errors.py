"""What is raised for a configuration that cannot be used."""

from __future__ import annotations


class ConfigError(ValueError):
    """A configuration that cannot be used; its text is one line for people."""
