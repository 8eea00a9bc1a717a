"""Written by ``python -m sim_bridge.plant.boom_derivation --write``; change the derivation and not this file.

Equations of motion of the boom, M [theta4'' theta5'' d6''] + h = F (thesis 2.2): see the derivation for the coordinates
and what is prescribed. Units: m, rad, s, kg, kg m2, J.
"""

from __future__ import annotations

from math import cos, sin

from numba import njit


@njit(cache=True, nogil=True)
def direction_of(
    theta4: float, theta5: float
) -> tuple[float, float, float]:
    """Return the unit vector from P to the nozzle, in tanker axes."""
    s0 = sin(theta5)
    out0 = -s0*cos(theta4)
    out1 = cos(theta5)
    out2 = -s0*sin(theta4)
    return out0, out1, out2


@njit(cache=True, nogil=True)
def jacobian_of(
    theta4: float, theta5: float
) -> tuple[float, float, float, float, float, float]:
    """Return d(direction)/d(theta4) and d(direction)/d(theta5), in tanker axes."""
    s0 = sin(theta4)
    s1 = sin(theta5)
    s2 = cos(theta4)
    s3 = cos(theta5)
    out0 = s0*s1
    out1 = 0.0
    out2 = -s1*s2
    out3 = -s2*s3
    out4 = -s1
    out5 = -s0*s3
    return out0, out1, out2, out3, out4, out5


@njit(cache=True, nogil=True)
def masses_of(
    theta4: float, theta5: float, d6: float, m_outer: float, com_outer: float, m_inner: float, com_inner: float,
    j_across: float, j_along: float
) -> tuple[float, float, float]:
    """Return the diagonal of M, which has nothing else."""
    s0 = sin(theta5)**2
    s1 = com_outer**2*m_outer
    s2 = m_inner*(com_inner - d6)**2
    out0 = j_across*s0 + j_along*cos(theta5)**2 + s0*s1 + s0*s2
    out1 = j_across + s1 + s2
    out2 = m_inner
    return out0, out1, out2


@njit(cache=True, nogil=True)
def bias_forces(
    theta4: float, theta5: float, d6: float, rate4: float, rate5: float, rate6: float, m_outer: float,
    com_outer: float, m_inner: float, com_inner: float, j_across: float, j_along: float, p: float, q: float,
    r: float, p_dot: float, q_dot: float, r_dot: float, f_x: float, f_y: float, f_z: float
) -> tuple[float, float, float]:
    """Return h4, h5, h6; f: specific force at P, p q r: the tanker's turning."""
    s0 = m_inner*rate6
    s1 = com_inner - d6
    s2 = sin(theta5)
    s3 = s2**2
    s4 = 2*s3
    s5 = s1*s4
    s6 = s0*s5
    s7 = cos(theta4)
    s8 = p*s7
    s9 = cos(theta5)
    s10 = 2*s1
    s11 = s0*s10
    s12 = s11*s9
    s13 = sin(theta4)
    s14 = s13*s2
    s15 = d6*m_inner
    s16 = -com_inner*m_inner + com_outer*m_outer + s15
    s17 = s16*s2
    s18 = com_inner**2*m_inner
    s19 = com_outer**2*m_outer
    s20 = d6**2*m_inner
    s21 = com_inner*s15
    s22 = j_across + s18 + s19 + s20 - 2*s21
    s23 = -j_along + s22
    s24 = s23*s9
    s25 = s2*s24
    s26 = 2*rate5
    s27 = s25*s26
    s28 = s25*s7
    s29 = s14*s24
    s30 = q*r
    s31 = r**2
    s32 = s23*s3
    s33 = s13*s32*s7
    s34 = p**2
    s35 = s13**2
    s36 = j_across*s3
    s37 = j_along*s3
    s38 = j_along + s18*s4 + s19*s4 + s20*s4 - 4*s21*s3 + 2*s36 - 2*s37
    s39 = rate5*s38
    s40 = r*s13
    s41 = s1*s26
    s42 = r*s7
    s43 = f_x*s7
    s44 = s16*s9
    s45 = q**2
    s46 = rate4**2
    s47 = s4 - 1
    s48 = rate4*s38
    s49 = s1*s3
    s50 = s10*s9
    s51 = s2*s50
    s52 = s14*s50
    out0 = (
        f_x*s14*s16 - f_z*s17*s7 + p*q*s29 - p*r*s32*(2*s35 - 1) - p_dot*s28 - q*s27 + q*s6 - q_dot*(j_along +
        s18*s3 + s19*s3 + s20*s3 - s21*s4 + s36 - s37) + r*s12*s14 - r_dot*s29 + rate4*s27 - rate4*s6 + s12*s2*s8 -
        s28*s30 + s31*s33 - s33*s34 + s39*s40 + s39*s8
    )
    out1 = (
        -f_y*s17 - f_z*s13*s44 + 2*m_inner*p*rate6*s1*s13 + p*q*s23*s47*s7 + 2*p*r*s13*s2*s23*s7*s9 - p_dot*s13*s22
        + q*r*s13*s23*s47 + 2*q*rate4*s2*s23*s9 + r_dot*s22*s7 - s0*s41 - s11*s42 + s2*s23*s31*s35*s9 - s25*s34*(s13
        - 1)*(s13 + 1) - s25*s45 - s25*s46 - s40*s48 - s43*s44 - s48*s8
    )
    out2 = (
        -m_inner*(-f_y*s9 + f_z*s14 + p*s13*s41 + q*rate4*s5 - q*s51*s8 + r*rate4*s52 + rate4*s51*s8 - rate5**2*s1 +
        s1*s31*(s14 - 1)*(s14 + 1) - s1*s34*(s3*s35 - s3 + 1) + s2*s43 - s30*s52 + s40*s5*s8 - s41*s42 - s45*s49 -
        s46*s49)
    )
    return out0, out1, out2


@njit(cache=True, nogil=True)
def energies_of(
    theta4: float, theta5: float, d6: float, rate4: float, rate5: float, rate6: float, m_outer: float,
    com_outer: float, m_inner: float, com_inner: float, j_across: float, j_along: float, p: float, q: float,
    r: float, u: float, v: float, w: float, g_x: float, g_y: float, g_z: float
) -> tuple[float, float]:
    """Return T and U, U from the height of P; u v w: velocity of P, g: gravity."""
    s0 = cos(theta5)
    s1 = q - rate4
    s2 = sin(theta5)
    s3 = sin(theta4)
    s4 = cos(theta4)
    s5 = rate5*s4
    s6 = r + s5
    s7 = s3*s6
    s8 = rate5*s3
    s9 = p - s8
    s10 = s4*s9
    s11 = rate5*s2
    s12 = s2*s3
    s13 = com_outer*s12
    s14 = s2*s4
    s15 = com_outer*s14
    s16 = com_outer*s0
    s17 = com_inner - d6
    s18 = s14*s17
    s19 = s12*s17
    s20 = s0*s17
    out0 = (
        (1/2)*j_across*((s3*s9 - s4*s6)**2 + (s0*s10 + s0*s7 + s1*s2)**2) + (1/2)*j_along*(-s0*s1 + s10*s2 +
        s2*s7)**2 + (1/2)*m_inner*((-p*s19 + r*s18 + rate6*s0 + s11*s17 + v)**2 + (p*s20 + q*s18 - rate4*s18 +
        rate6*s2*s3 - s20*s8 - w)**2 + (-q*s19 - r*s20 + rate4*s17*s2*s3 + rate6*s2*s4 - s20*s5 - u)**2) +
        (1/2)*m_outer*((-com_outer*s11 + p*s13 - r*s15 + v)**2 + (p*s16 + q*s15 - rate4*s15 - s16*s8 + w)**2 +
        (q*s13 + r*s16 - rate4*s13 + s16*s5 - u)**2)
    )
    out1 = (com_outer*m_outer - m_inner*s17)*(g_x*s14 - g_y*s0 + g_z*s12)
    return out0, out1
