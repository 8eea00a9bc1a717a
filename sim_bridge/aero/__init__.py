"""Potential flow about thin lifting surfaces: what the derivatives of the aircraft and the tanker's wake come from."""
