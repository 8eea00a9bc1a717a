"""The fault matrix in lockstep: each cell a named flight; its expected result stands in ``sim_bridge.fault_matrix``.

Each begins near the box, docks by the refuelling's phases, and suffers its fault in the hold (``approach-``: on the
way). Expected: it ends as its cell says (held, breakaway and for what cause, or standby), the receptacle is never
outside the limit box below the tanker, the receiver never in the tanker's space, no setpoint wild, what is refused is
counted, the fault has changed samples, and a breakaway begins within 0.5 s of its cause and not before it.
"""

import pytest

from sim_bridge.fault_cells import MATRIX, MORE
from sim_bridge.fault_matrix import LEVEL_S, fly_cell
from sim_bridge.fault_table import row

SEED = 401

QUICK = ("camera-boom", "camera-boresight", "lights-half", "lights-all", "datalink-velocity", "link-second_vehicle",
         "link-forged", "clock-step", "mount-off-at-first", "approach-camera-off")
"""Of what is not in the matrix, so much in every run of the tests."""


def cells(which):
    return [pytest.param(cell, id=cell.name) for cell in which]


def check(cell, seed, **watched):
    flight = fly_cell(cell, seed, **watched)
    phases = [(c.t_ns / 1e9, str(c.new)) for c in flight.phases]
    told = f"{row(flight)}\n{flight.safety}\n{dict(flight.rejects)}\n{phases}"
    assert flight.suffered, (told, flight.touched)
    assert flight.safe, told
    assert flight.as_it_has_to, told
    assert flight.in_time, told


@pytest.mark.parametrize("cell", cells(MATRIX))
def test_matrix(cell):
    """{camera, datalink, gps, attitude, heartbeat} x {off, stuck, garbage, wrong, slow, delayed, intermittent}."""
    check(cell, SEED)


@pytest.mark.parametrize("cell", cells(c for c in MORE if c.name in QUICK))
def test_more(cell):
    """Lights, boom over the lens, mount, others on the link, clocks, and a fault in the approach."""
    check(cell, SEED)


@pytest.mark.slow
@pytest.mark.parametrize("cell", cells(c for c in MORE if c.name not in QUICK))
def test_yet_more(cell):
    """Stamps that lie, NaN, and what else a link can tell."""
    check(cell, SEED)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(SEED + 2, SEED + 7))
@pytest.mark.parametrize("cell", cells((*MATRIX, *MORE)))
def test_other_seeds(cell, seed):
    """The same with other gusts and other noise, and a breakaway watched until the receiver is level again."""
    check(cell, seed, away_s=LEVEL_S)
