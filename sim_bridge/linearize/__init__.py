"""Trim, linear models and modes of both aircraft (thesis 2.1, 3.1; ``sim-bridge linearize``)."""

from sim_bridge.linearize.model import LATERAL, LONGITUDINAL, STATES, Condition, Mode, coupling, modes_of
from sim_bridge.linearize.receiver import AIRFRAME_FILE, Linearization, linearize, write_airframe
from sim_bridge.linearize.tables import report, structure, tanker_report
from sim_bridge.linearize.tanker import TankerModel, linearize_tanker

__all__ = [
    "AIRFRAME_FILE",
    "LATERAL",
    "LONGITUDINAL",
    "STATES",
    "Condition",
    "Linearization",
    "Mode",
    "TankerModel",
    "coupling",
    "linearize",
    "linearize_tanker",
    "modes_of",
    "report",
    "structure",
    "tanker_report",
    "write_airframe",
]
