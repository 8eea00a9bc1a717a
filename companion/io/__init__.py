"""Adapters between the world and the core: one foreign library per file, wire types stop here."""
