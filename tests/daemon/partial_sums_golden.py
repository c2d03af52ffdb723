"""Writes, by hand and from the grammar alone, the part that partial_sums_test.cpp reads and writes again byte for byte.

Usage: python3 partial_sums_golden.py > partial_sums_golden.inc     (committed beside it)
"""
import json
import math
import struct
import sys

MASK = (1 << 64) - 1


def crc32c(data):
    crc = 0xFFFFFFFF
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = (crc >> 1) ^ (0x82F63B78 if crc & 1 else 0)
    return crc ^ 0xFFFFFFFF


assert crc32c(b"123456789") == 0xE3069283


def bits(x):
    return struct.unpack("<Q", struct.pack("<d", x))[0]


def m(x):
    x = x * 0x9E3779B97F4A7C15 & MASK
    x ^= x >> 29
    x = x * 0xBF58476D1CE4E5B9 & MASK
    return x ^ (x >> 32)


def hash_of(r, v, z):
    return m(m(m(bits(r)) ^ bits(v)) ^ bits(z)) >> 32


def section(kind, payload):
    head = struct.pack("<IIQI", kind, 0, len(payload), crc32c(payload))
    return head + struct.pack("<I", crc32c(head)) + payload + bytes(-len(payload) % 8)


P, Q, ALONG, PER_ARC, ARCS = 2, 1, 4, 2, 4
grid = {
    "format": "celadon-grid",
    "version": 1,
    "units": {"length": "mm", "angle": "rad"},
    "base": "cylinder",
    "band": [-8.0, 24.0],
    "intervals": [ALONG, PER_ARC],
    "degree": [P, Q],
    "arcs": {"start_rad": 0.0, "range_rad": 2 * math.pi, "closed": True},
    "frame": {"origin": [1.5, -2.0, 0.25], "x": [0.0, 1.0, 0.0], "y": [0.0, 0.0, 1.0], "z": [1.0, 0.0, 0.0]},
    "millimetres_per_unit": 25.4,
    "weights": "unit",
}
# (r, v, z), dyadic: all sums are exact in whatever order.
samples = [(30.5, 0.125, -7.0), (31.25, 0.375, -1.5), (29.75, 0.25, -4.0), (30.0, 0.0, 23.0), (28.5, 2.0625, 10.5)]

cells, rims = {}, {}
for r, v, z in samples:
    x, y = (z + 8) / 32 * ALONG, v * PER_ARC
    i, j = int(x), int(y)
    s, t = 2 * (x - i) - 1, 2 * (y - j) - 1
    cell = cells.setdefault(j * ALONG + i, [0.0] * ((2 * P + 1) * (2 * Q + 1) + (P + 1) * (Q + 1) + 1))
    weight = [s**b * t**a for b in range(2 * P + 1) for a in range(2 * Q + 1)]
    ranges = [r * s**b * t**a for b in range(P + 1) for a in range(Q + 1)]
    for k, value in enumerate(weight + ranges + [r * r]):
        cell[k] += value
    sector = int(v * min(16, PER_ARC * ARCS) / ARCS)
    low, high = rims.get((i, sector), (math.inf, -math.inf))
    rims[i, sector] = (min(low, z), max(high, z))

payload = struct.pack("<Q", len(cells))
for k in sorted(cells):
    payload += struct.pack("<Q%dd" % len(cells[k]), k, *cells[k])
places = [(i, sector) for i in range(ALONG) for sector in range(16)]
limits = [rims.get(at, (math.inf, -math.inf)) for at in places]
sample = struct.pack("<IIQ", 0xFFFFFFFF, 0, len(samples))
for r, v, z in samples:
    sample += struct.pack("<IIddd", hash_of(r, v, z), 0, r, v, z)

part = b"\x89CES\r\n\x1a\n" + struct.pack("<HHI", 1, 0, 6)
part += section(1, (json.dumps(grid, indent=2) + "\n").encode())
part += section(2, b'{"inputs":["a.xyz","b.xyz"],"writer":"celadon"}')
part += section(3, struct.pack("<5Q", 5, 1, 2, 3, 11))
part += section(4, payload)
part += section(5, struct.pack("<%dd" % (2 * len(places)), *[l for l, _ in limits], *[h for _, h in limits]))
part += section(6, sample)

out = sys.stdout
out.write("// Written by partial_sums_golden.py from the grammar; do not edit.\n")
for i in range(0, len(part), 20):
    out.write(", ".join("0x%02x" % b for b in part[i : i + 20]) + ",\n")
