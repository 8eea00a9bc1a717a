"""How a flight sees: parts of a scenario. Every default is the thesis' sensor (3.2) or the chain's own noise."""

from __future__ import annotations

from companion.config import Struct


class MarkerSensorConditions(Struct, frozen=True, kw_only=True):
    """Simulated detections, ``vision_input = "detections"``: what stands in for picture and detection.

    ``sigma_px``: standard deviation of a centroid per axis. The picture chain's own, against the truth of whole flights
    with both cameras, is 0.025 to 0.04 px at 10 to 60 m. ``dropout``: probability that a marker is not seen in a frame,
    each for itself.
    """

    sigma_px: float = 0.035
    dropout: float = 0.0


def sensor_rules(markers: MarkerSensorConditions) -> list[tuple[bool, str]]:
    """Return what must hold of the conditions, each with the text for when it does not."""
    return [
        (0.0 <= markers.sigma_px <= 20.0, "markers.sigma_px: must be in 0..20 pixels"),
        (0.0 <= markers.dropout <= 1.0, "markers.dropout: is a probability and must be in 0..1"),
    ]
