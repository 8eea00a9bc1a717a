"""What the thesis printed in its chapter 7: the numbers that ours are put beside."""

from __future__ import annotations

CALLS = 401
"""Calls of a solver in 40 s at 0.1 s (7.2; the text prints 4010)."""

FLOPS = {("GLSDC", "sv"): 19949385, ("LHM", "sv"): 12051938, ("GLSDC", "rv"): 14222319, ("LHM", "rv"): 21019524}
"""Tab. 7.1: operations of the whole run."""

SECONDS_PER_CALL = {
    ("GLSDC", "sv"): 0.0053910447761, ("LHM", "sv"): 0.0158049751244,
    ("GLSDC", "rv"): 0.0053000000000, ("LHM", "rv"): 0.02006865671642,
}
"""Tab. 7.2: Matlab on a Pentium 4 of 2.53 GHz."""

DELAY_S = {"GLSDC": 0.30, "LHM": 0.25}
"""Section 7.3, simulated vision."""

RMS = {
    "7.3": {
        "GLSDC": (1.7042, 0.9291, 3.0024, 0.0500, 0.0127, 0.0438),
        "LHM": (1.2936, 1.2955, 0.8005, 0.0039, 0.0214, 0.0025),
    },
    "7.4": {
        "GLSDC": (1.7395, 0.9225, 3.0089, 0.0488, 0.0193, 0.0444),
        "LHM": (1.4474, 1.3117, 0.8040, 0.0156, 0.0242, 0.0137),
    },
    "7.5": {
        "GLSDC": (0.3254, 0.0962, 0.1679, 0.0090, 0.0150, 0.0098),
        "LHM": (0.3364, 0.0963, 0.1367, 0.0109, 0.0125, 0.0104),
    },
}
"""Tab. 7.3 (SV), 7.4 (RV), 7.5 (RV, 15 to 50 s): x y z in m, roll pitch yaw in rad."""

NOISE_POWERS = (0.0, 1e-9, 2e-9, 3e-9, 4e-9, 5e-9)
CORRELATION_TIME_S = 0.05
"""Section 7.5.1: variance of the noise on the sensor, in m^2, is the power divided by this time."""

DIVERGED = {"GLSDC": 1, "LHM": 0}
"""Of one run at 5e-9 (7.5.1); with uncertain labeling GLSDC at 4e-9 already (7.5.3)."""

SWAP_X_M = {"before": 42.8, "GLSDC": 12.6, "LHM": 33.5}
SWAP_GOOD_AGAIN_S = {"GLSDC": 20.6, "LHM": 20.3}
SWAP_AT_S = (20.0, 20.1)
SWAP_SEEN = ((1, 2, 3, 5, 6, 7, 8, 9), (1, 2, 3, 4, 6, 7, 8))
"""Section 7.5.2: markers seen in the two frames."""

CONVERGENCE_MARKERS = (1, 3, 4, 6, 9)
X0_M = (60.5, 20.0, -2.5)
X0_PSI_THETA_PHI_RAD = (0.0, 0.467, 0.0)
CONVERGENCE_OFFSET_M = {"GLSDC": (-44.7, 65.4)}
CONVERGENCE_YAW_RAD = {"GLSDC": (-1.74, 3.06)}
"""Tab. 7.6. LHM: any translation, and any yaw of the whole turn."""

INPUT_NOISE = {
    1e-9: (-4.856e-4, 4.272e-4, -1.367e-6, 1.403e-4),
    2e-9: (-6.867e-4, 6.041e-4, -1.933e-6, 1.984e-4),
    3e-9: (-8.410e-4, 7.399e-4, -2.368e-6, 2.431e-4),
}
"""Tab. 7.7: min, max, mean, standard deviation in m on the sensor (the last row's first number misses its sign)."""
