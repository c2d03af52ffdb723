# The peer for bodies over a sphere: FITPACK's least squares spline (Dierckx 1984), closed at both poles.
# python3 sphere_peer.py SAMPLES THETA_KNOTS PHI_KNOTS CHECK: SAMPLES and CHECK hold doubles phi, theta, rho; prints the
# seconds of the fit, its number of coefficients, RMS and largest miss of CHECK, and how far the poles tear (all mm).
import sys
import time
import warnings

import numpy as np
from scipy.interpolate import LSQSphereBivariateSpline

warnings.simplefilter("ignore")
phi, theta, rho = np.fromfile(sys.argv[1]).reshape(-1, 3).T
check = np.fromfile(sys.argv[4]).reshape(-1, 3).T
inner = lambda end, count: np.linspace(0, end, count + 2)[1:-1]
start = time.process_time()
spline = LSQSphereBivariateSpline(phi, theta, rho, inner(np.pi, int(sys.argv[3])), inner(2 * np.pi, int(sys.argv[2])))
seconds = time.process_time() - start
miss = spline.ev(check[0], check[1]) - check[2]
ring = 2 * np.pi * np.arange(90) / 90
tear = max(np.ptp(spline.ev(np.full(90, at), ring)) for at in (0.0, np.pi))
print(seconds, len(spline.get_coeffs()), np.sqrt(np.mean(miss**2)), np.max(np.abs(miss)), tear)
