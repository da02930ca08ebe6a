"""The algebra of the textbook, signs included, from the frames up: what stands in the code is put against sympy.

f = (0, 0, 1) g up; the table turns about an axis at azimuth 0 and elevation E, and body = mounting⁻¹ · Rz(−φ) · table.
"""

import numpy as np
import pytest
import sympy as sp

from imubayes.procedures.fitted_terms import drift_terms, estimable, rank
from imubayes.procedures.polar_tumble import COEFFICIENTS, standard_combinations

PHI, LATITUDE = sp.symbols("phi L", real=True)
C, S = sp.cos(LATITUDE), sp.sin(LATITUDE)


def up_in_table(elevation):
    """Gravity's reaction in table axes: the columns of C_nt0 = Rx(−(90° − E)), then Rz(−φ)."""
    tilt = -(sp.pi / 2 - elevation)
    at_zero = sp.Matrix([[1, 0, 0], [0, sp.cos(tilt), -sp.sin(tilt)], [0, sp.sin(tilt), sp.cos(tilt)]])
    back = sp.Matrix([[sp.cos(PHI), sp.sin(PHI), 0], [-sp.sin(PHI), sp.cos(PHI), 0], [0, 0, 1]])
    return back * at_zero.T * sp.Matrix([0, 0, 1])


def fourier(signal, angle, order):
    """B0, C1, S1, C2, S2, … exactly."""
    waves = [wave(k * angle) for k in range(1, order + 1) for wave in (sp.cos, sp.sin)]
    around = (angle, 0, 2 * sp.pi)
    mean = sp.integrate(signal, around) / (2 * sp.pi)
    return [sp.simplify(mean), *(sp.simplify(sp.integrate(sp.expand(signal * w), around) / sp.pi) for w in waves)]


# Columns of the mounting are I, O and S = I × O in table axes; the specific force along them.
SEATS = {
    "O→Np": lambda x, y, z: (x, z, -y),
    "O→Sp": lambda x, y, z: (x, -z, y),
    "S→Np": lambda x, y, z: (x, y, z),
    "S→Sp": lambda x, y, z: (y, x, -z),
    "I→Np": lambda x, y, z: (z, x, y),
}


def drift_of(force, coefficients):
    d_f, d_i, d_o, d_s, d_ii, d_oo, d_ss, d_io, d_os, d_si = coefficients
    i, o, s = force
    drift = d_f + d_i * i + d_o * o + d_s * s + d_ii * i**2 + d_oo * o**2 + d_ss * s**2
    return drift + d_io * i * o + d_os * o * s + d_si * s * i


@pytest.mark.compiled  # algebra of three seconds
def test_polar_sweeps_north_and_south_have_the_harmonics_of_the_docstring():
    coefficients = sp.symbols("D_F D_I D_O D_S D_II D_OO D_SS D_IO D_OS D_SI")
    d_f, d_i, d_o, d_s, d_ii, d_oo, d_ss, d_io, d_os, d_si = coefficients
    for seat, sign in (("O→Np", 1), ("O→Sp", -1)):
        # At this mounting f_I = −cos L sin φ.
        force = SEATS[seat](*up_in_table(LATITUDE))
        b0, c1, s1, c2, s2 = fourier(sp.expand(drift_of(force, coefficients)), PHI, 2)
        half = sp.Rational(1, 2)
        expected = {
            b0: d_f + sign * d_o * S + d_oo * S**2 + half * (d_ii + d_ss) * C**2,
            s1: -d_i * C - sign * half * d_io * sp.sin(2 * LATITUDE),
            c1: sign * d_s * C + half * d_os * sp.sin(2 * LATITUDE),
            c2: half * (d_ss - d_ii) * C**2,
            s2: -sign * half * d_si * C**2,
        }
        for found, wanted in expected.items():
            assert sp.simplify(sp.expand_trig(found - wanted)) == 0


@pytest.mark.parametrize("seats", [("O→Np", "O→Sp"), ("S→Np", "S→Sp"), ("O→Np",), tuple(SEATS)])
def test_what_is_called_estimable_is_what_the_harmonics_determine(seats):
    """The rank is that of the exact Fourier coefficients, and every combination lies in their span."""
    latitude, angle = 0.6, np.arange(8) * np.pi / 4
    rows, exact = [], []
    for seat in seats:
        force = SEATS[seat](*(sp.lambdify((PHI, LATITUDE), one)(angle, latitude) for one in up_in_table(LATITUDE)))
        rows.append(drift_terms(np.stack([np.broadcast_to(one, angle.shape) for one in force])))
        # Terms of the second order at most: eight positions give their Fourier coefficients exactly.
        exact += [np.mean(wave[:, None] * rows[-1], axis=0) for wave in map(np.exp, 1j * np.outer([0, 1, 2], angle))]
    exact = np.concatenate([np.real(exact), np.imag(exact)])
    found = estimable(np.concatenate(rows), COEFFICIENTS, standard_combinations(latitude))
    weights = np.array([one.weights for one in found])
    assert len(found) == np.linalg.matrix_rank(exact, tol=1e-9) == rank(np.concatenate(rows))
    assert np.linalg.matrix_rank(weights) == len(found)
    assert np.linalg.matrix_rank(np.concatenate([exact, weights]), tol=1e-9) == len(found)
    if seats == ("O→Np", "O→Sp"):
        assert {one.symbol for one in found if not one.single} == {"D_II-D_SS", "D_F+D_OO·sin²L+½(D_II+D_SS)·cos²L"}
    if len(seats) == 5:
        assert {one.symbol for one in found if not one.single} == {"D_II-D_SS", "D_II-D_OO", "D_F+D_II"}


def test_the_earth_rate_on_an_input_axis_across_the_pole_is_zero():
    tilt = -(sp.pi / 2 - LATITUDE)
    at_zero = sp.Matrix([[1, 0, 0], [0, sp.cos(tilt), -sp.sin(tilt)], [0, sp.sin(tilt), sp.cos(tilt)]])
    earth = at_zero.T * sp.Matrix([0, C, S])
    assert sp.simplify(earth[0]) == 0
    assert sp.simplify(earth[1]) == 0
    assert sp.simplify(earth[2]) == 1


@pytest.mark.slow  # algebra of ten seconds; test_tumble_terms.py has the same terms in numbers
def test_tumble_harmonics_are_those_of_the_docstring():
    psi = sp.symbols("psi", real=True)
    k0, k2, k3, k_xx, delta, k_ix = sp.symbols("K0 K2 K3 K_xx delta K_ix")
    a, x = sp.cos(psi), sp.sin(psi)
    smooth = fourier(sp.expand(k0 + a + k2 * a**2 + k3 * a**3 + k_xx * x**2 + delta * x + k_ix * a * x), psi, 3)
    # a·|a| is even and changes sign at ±90°: integrate the half circle with a > 0, twice.
    bent = [
        sp.simplify(2 * sp.integrate(a**2 * sp.cos(k * psi), (psi, -sp.pi / 2, sp.pi / 2)) / sp.pi) for k in (1, 3, 5)
    ]
    b0, c1, s1, c2, s2, c3, _ = smooth
    assert sp.simplify(b0 - (k0 + (k2 + k_xx) / 2)) == 0
    assert sp.simplify(c1 - (1 + sp.Rational(3, 4) * k3)) == 0
    assert sp.simplify(s1 - delta) == 0
    assert sp.simplify(c2 - (k2 - k_xx) / 2) == 0
    assert sp.simplify(s2 - k_ix / 2) == 0
    assert sp.simplify(c3 - k3 / 4) == 0
    assert bent == [8 / (3 * sp.pi), 8 / (15 * sp.pi), -8 / (105 * sp.pi)]
