"""What is raised for a configuration that cannot be used, and for a file that cannot be read."""

from __future__ import annotations

from pathlib import Path


class ConfigError(ValueError):
    """A configuration that cannot be used; its text is one line for people."""


def read_text(file: Path) -> str:
    """Return what is in a file; raises ConfigError naming it."""
    try:
        return file.read_text(encoding="utf-8")
    except FileNotFoundError:
        msg = f"{file}: no such file"
        raise ConfigError(msg) from None
    except (OSError, UnicodeDecodeError) as error:
        msg = f"{file}: cannot be read ({error})"
        raise ConfigError(msg) from None
