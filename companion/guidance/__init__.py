"""What to fly: phases, reference path, docking law, and the guard that every setpoint passes last."""
