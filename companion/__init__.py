"""Onboard service that brings a receiver aircraft into a tanker's refuelling window on vision."""

__version__ = "0.1.0"
