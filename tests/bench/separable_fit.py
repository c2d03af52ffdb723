# The peer for complete regular grids: scipy's separable least squares, one spline fit along each direction.
# python3 separable_fit.py RUNS: fits a 1000 x 1000 grid with 64 x 32 coefficients, prints the median time in ms and the RMS to truth in mm.
import sys
import time

import numpy as np
from scipy.interpolate import make_lsq_spline

N, SIZE, HEIGHT = 1000, (64, 32), 120.0


def truth(t, z):
    return (30 + 6 * np.sin(2 * np.pi * z / 120) + 3 * np.cos(2 * t) * np.sin(np.pi * z / 120)
            + 1.5 * np.cos(5 * t + 0.05 * z))


def knots(end, count):
    return np.concatenate([[0.0] * 3, np.linspace(0, end, count - 2), [end] * 3])


theta = 2 * np.pi * np.arange(N) / N
z = np.linspace(0, HEIGHT, N)
r = truth(theta[:, None], z[None, :]) + np.random.default_rng(1).normal(0, 0.02, (N, N))


def fit():
    along_z = make_lsq_spline(z, r.T, knots(HEIGHT, SIZE[1]))
    return make_lsq_spline(theta, along_z.c.T, knots(2 * np.pi, SIZE[0])), along_z.t


times = []
for _ in range(int(sys.argv[1])):
    start = time.process_time()
    around, knots_z = fit()
    times.append(time.process_time() - start)

t, h = 2 * np.pi * (np.arange(200) + 0.5) / 200 * 0.98, np.linspace(0, HEIGHT, 101)
along = make_lsq_spline(z, r.T, knots_z)
along.c = around(t).T
miss = along(h).T - truth(t[:, None], h[None, :])
print(1e3 * np.median(times), np.sqrt(np.mean(miss**2)))
