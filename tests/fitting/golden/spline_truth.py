#!/usr/bin/env python3
"""Golden data of tests/fitting: B-spline bases and closed range spaces, by numpy and by another way than the code's.

Bases: the recursive definition of divided differences' weights (Cox - de Boor), function by function over the whole
knot vector. Range spaces: all piecewise polynomials over the breaks (Bernstein form, no spline at all), restricted to
the null space of the continuity conditions written in theta (curvature) or v (thesis); a space is recorded by what
least squares in it makes of a test function: numbers that do not depend on any basis.

Run it to rewrite basis.txt and range_space.txt beside it.
"""
import math
import os
import numpy as np

HERE = os.path.dirname(os.path.abspath(__file__))
rng = np.random.default_rng(20020101)


def cox(knots, i, p, t):
    if p == 0:
        return 1.0 if knots[i] <= t < knots[i + 1] else 0.0
    total = 0.0
    if knots[i + p] > knots[i]:
        total += (t - knots[i]) / (knots[i + p] - knots[i]) * cox(knots, i, p - 1, t)
    if knots[i + p + 1] > knots[i + 1]:
        total += (knots[i + p + 1] - t) / (knots[i + p + 1] - knots[i + 1]) * cox(knots, i + 1, p - 1, t)
    return total


def cox_derivative(knots, i, p, t, order):
    if order == 0:
        return cox(knots, i, p, t)
    if p == 0:
        return 0.0
    total = 0.0
    if knots[i + p] > knots[i]:
        total += p / (knots[i + p] - knots[i]) * cox_derivative(knots, i, p - 1, t, order - 1)
    if knots[i + p + 1] > knots[i + 1]:
        total -= p / (knots[i + p + 1] - knots[i + 1]) * cox_derivative(knots, i + 1, p - 1, t, order - 1)
    return total


def numbers(values):
    return " ".join("%.17g" % v for v in values)


def write_bases(path):
    """Each case: degree, count of knots, knots; count of parameters; per parameter t and, for orders 0, 1, 2, all values."""
    with open(path, "w") as out:
        for degree in range(1, 8):
            inner = np.sort(rng.random(6))
            inner = np.insert(inner, 2, [inner[2]] * (degree // 2))  # a knot of higher multiplicity
            knots = np.concatenate([[0.0] * (degree + 1), inner, [1.0] * (degree + 1)])
            n = len(knots) - degree - 1
            ts = np.concatenate([rng.random(4), [0.0, inner[2]]])
            out.write("%d %d %s\n%d\n" % (degree, len(knots), numbers(knots), len(ts)))
            for t in ts:
                out.write("%.17g\n" % t)
                for order in range(3):
                    out.write(numbers([cox_derivative(knots, i, degree, t, order) for i in range(n)]) + "\n")


ARC = math.pi / 2
W = math.cos(ARC / 2)


def v_of_theta(theta):
    """(2.7) as printed."""
    j = np.minimum(np.floor(theta / ARC), 3)
    t = np.tan((theta - j * ARC) / 2)
    return j + t / (math.sqrt(1 - W * W) + (1 - W) * t)


def bernstein_derivatives(q, x):
    """Rows: derivative 0 ... q of all Bernstein polynomials of degree q at x in {0, 1}."""
    rows = []
    for order in range(q + 1):
        row = np.zeros(q + 1)
        for k in range(q + 1):
            c = np.zeros(q + 1)
            c[k] = 1
            for d in range(order):
                c = np.diff(c) * (q - d)
            row[k] = c[0] if x == 0 else c[-1]
        rows.append(row)
    return np.array(rows)


def null_space(q, breaks, curvature):
    """Orthonormal basis of the space in Bernstein coefficients, interval by interval."""
    m = len(breaks) - 1
    conditions = []
    at0, at1 = bernstein_derivatives(q, 0), bernstein_derivatives(q, 1)
    # d eta/d theta and its derivative at an arc's start and end
    first, second = 1 / (2 * math.sqrt(1 - W * W)), 1 / (2 * (1 + W))
    for k in range(m):
        left, right = k - 1, k
        hl = breaks[left + 1] - breaks[left] if left >= 0 else breaks[m] - breaks[m - 1]
        hr = breaks[right + 1] - breaks[right]
        joint = abs(breaks[k] - round(breaks[k])) < 1e-12
        orders = 3 if (joint and curvature) else q
        for order in range(orders):
            row = np.zeros((m, q + 1))
            a, b = at1[order] / hl**order, at0[order] / hr**order
            if joint and curvature:  # in theta: F'' v'^2 + F' v''
                scale = first**order
                a, b = a * scale, b * scale
                if order == 2:
                    a = a + at1[1] / hl * second
                    b = b - at0[1] / hr * second
            row[left % m] += a
            row[right] -= b
            conditions.append(row.ravel() / np.abs(row).max())
    conditions = np.array(conditions)
    _, s, vt = np.linalg.svd(conditions)
    rank = int((s > 1e-10 * s[0]).sum())
    return vt[rank:].T


def collocation(q, breaks, v):
    m = len(breaks) - 1
    A = np.zeros((len(v), m * (q + 1)))
    k = np.clip(np.searchsorted(breaks, v, side="right") - 1, 0, m - 1)
    x = (v - breaks[k]) / (breaks[k + 1] - breaks[k])
    for i in range(q + 1):
        A[np.arange(len(v)), k * (q + 1) + i] = math.comb(q, i) * x**i * (1 - x) ** (q - i)
    return A


def function(t):
    return 30 + 3 * np.cos(2 * t + 0.3) + 1.5 * np.cos(5 * t + 1) + 0.8 * np.sin(3 * t)


def write_spaces(path):
    """Each case: degree, curvature (1) or thesis (0), count of breaks, breaks; dimension; count of angles; lines of
    theta and the fitted value. Fitted to `function` at 720 equal angles (i + 0.5)."""
    theta = (np.arange(720) + 0.5) / 720 * 2 * np.pi
    v = v_of_theta(theta)
    where = np.sort(rng.random(12)) * 2 * np.pi
    with open(path, "w") as out:
        def layouts():
            yield [np.arange(1, 4) / 4] * 4
            widths = [rng.random(k) + 0.3 for k in (4, 6, 3, 8)]
            yield [np.cumsum(w)[:-1] / w.sum() for w in widths]
            yield [np.array([])] * 4
            yield [np.array([]), np.array([0.3]), np.array([0.2, 0.9]), np.array([])]
        for q in (1, 2, 3, 4, 5):
            for curvature in (True, False):
                if curvature and q < 3:
                    continue
                for arcs in layouts():
                    breaks = np.concatenate([j + np.concatenate([[0.0], a]) for j, a in enumerate(arcs)] + [[4.0]])
                    Z = null_space(q, breaks, curvature)
                    x = np.linalg.lstsq(collocation(q, breaks, v) @ Z, function(theta), rcond=None)[0]
                    fitted = collocation(q, breaks, v_of_theta(where)) @ Z @ x
                    out.write("%d %d %d %s\n%d\n%d\n" % (q, curvature, len(breaks), numbers(breaks), Z.shape[1], len(where)))
                    for t, value in zip(where, fitted):
                        out.write("%.17g %.17g\n" % (t, value))


if __name__ == "__main__":
    write_bases(os.path.join(HERE, "basis.txt"))
    write_spaces(os.path.join(HERE, "range_space.txt"))
