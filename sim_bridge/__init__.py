"""Stands in for everything outside the companion: two aircraft, weather, sensors, camera, autopilot, datalink."""
