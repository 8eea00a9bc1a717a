"""Stand-in autopilot: inner loops, MAVLink vehicle, and what the tanker tells of itself."""

from sim_bridge.autopilot.standin import StandInAutopilot, TankerReporter

__all__ = ["StandInAutopilot", "TankerReporter"]
