"""Writes, by hand and from the grammar alone, the log that profile_log_test.cpp compares byte for byte.

Usage: python3 profile_log_golden.py > profile_log_golden.inc              (committed beside it)
       python3 profile_log_golden.py 1.0 > profile_log_golden_1_0.inc      the same by version 1.0
       python3 profile_log_golden.py 1.1 > profile_log_golden_1_1.inc      and by version 1.1
       python3 profile_log_golden.py 1.3 > profile_log_golden_1_3.inc      and with colours, by version 1.3
"""
import struct
import sys


def crc32c(data):
    crc = 0xFFFFFFFF
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = (crc >> 1) ^ (0x82F63B78 if crc & 1 else 0)
    return crc ^ 0xFFFFFFFF


assert crc32c(b"123456789") == 0xE3069283


def record(number, kind, payload):
    head = struct.pack("<4sHHIII", b"CLPR", kind, 0, len(payload), number, crc32c(payload))
    return head + struct.pack("<I", crc32c(head)) + payload + bytes(-len(payload) % 8)


minor = int(sys.argv[1].split(".")[1]) if len(sys.argv) > 1 else 2
header = (
    b'{"calibration":"text of\\na calibration","camera":"camera 1",'
    + (b'"colour":true,' if minor >= 3 else b"")
    + b'"date":"2026-01-02T03:04:05Z",'
    + (b'"lasers":[1,0],' if minor >= 1 else b"")
    + b'"machine":"machine 1","request":{"degree_u":3,"degree_v":3,"exposure_ms":0.0,'
    b'"formats":["step","stl","ply","surface.json"],"mode":"sweep","model":"auto","name":"vase","profiles":1200,"shape":"cylinder",'
    b'"tolerance_mm":0.0},"simulated":true,"writer":"celadond 0.1.0"}'
)
identity = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0]
pose0 = struct.pack("<HHI12d21d", 0, 0, 0, *identity, *[0.0] * 21)
position = struct.pack("<IIQdqq", 7, 0, 123456, 0.25, 1000, 2000)
frame = struct.pack("<QqqIHH", 41, 1500, 4000000, 2, 0, 0)
profile = struct.pack("<IHBBdddII".replace("ddd", "ddq"), 3, 0, 1, 0, 1.5, 0.25, 1500, 2, 3)
profile += struct.pack("<2d2d2d", 30.0, 30.5, 0.25, 0.26, 10.0, 11.0)
profile += struct.pack("<12f", *[float(k) for k in range(1, 13)])
profile += struct.pack("<2H", 100, 101)
overlap = struct.pack("<IHBBddqII", 4, 0, 0, 1, 0.0, 6.5, 1600, 1, 0) + struct.pack("<3d", 30.0, 6.5, 10.0)
if minor >= 3:
    profile += bytes([200, 40, 90, 0, 0, 0])
    overlap += bytes([1, 2, 3])
end = struct.pack("<HHIQQQQQ", 1, 0, 1, 2, 1, 2, 0, 0) + b"button pressed"

stop = [(8, struct.pack("<dd", 0.5, 30.0))] if minor >= 2 else []

log = b"\x89CEL\r\n\x1a\n" + struct.pack("<HHI", 1, minor, 0)
for number, (kind, payload) in enumerate(
    [(1, header), (2, pose0), (5, position), (6, frame), *stop, (3, profile), (4, overlap), (7, end)]
):
    log += record(number, kind, payload)

out = sys.stdout
out.write("// Written by profile_log_golden.py from the grammar; do not edit.\n")
for i in range(0, len(log), 20):
    out.write(", ".join("0x%02x" % b for b in log[i : i + 20]) + ",\n")
