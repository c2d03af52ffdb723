#!/usr/bin/env python3
"""usbip_seeds.py FOLDER: valid streams of USB/IP as a beginning for fuzz_usbip."""
import pathlib
import struct
import sys


def submit(number, into, endpoint, length, setup=bytes(8), data=b""):
    return struct.pack(">10I", 1, number, 0x10002, into, endpoint, 0, length, 0, 0, 0) + setup + data


def control(number, kind, request, value, index, length, data=b""):
    setup = struct.pack("<BBHHH", kind, request, value, index, length)
    return submit(number, kind >> 7, 0, length, setup, data)


def unlink(number, other):
    return struct.pack(">6I", 2, number, 0x10002, 0, 0, other) + bytes(24)


probe = struct.pack("<H2BI", 1, 3, 1, 333333) + bytes(18)
streams = {
    "list": b"\x01\xff" + struct.pack(">HHI", 0x111, 0x8005, 0),
    "import": b"\x81\xff" + struct.pack(">HHI", 0x111, 0x8003, 0) + b"1-1".ljust(32, b"\0") + control(1, 0x80, 6, 0x100, 0, 18),
    "enumerate": b"\x80\xff" + b"".join(control(n, 0x80, 6, v, 0, 255) for n, v in enumerate([0x100, 0x200, 0x300, 0x302])) +
    control(9, 0, 9, 1, 0, 0),
    "controller": b"\x80\x2f" + control(1, 0xC1, 1, 0, 0, 96) + control(2, 0x41, 3, 0, 0, 2, b"\0\1") + control(3, 0xC1, 4, 0, 0, 2) +
    submit(4, 1, 1, 64) + submit(5, 1, 2, 4096) + submit(6, 1, 1, 64) + unlink(7, 6) + control(8, 2, 1, 0, 0x81, 0),
    "camera": b"\x80\x7f" + control(1, 0x21, 1, 0x100, 2, 26, probe) + control(2, 0x21, 1, 0x200, 2, 26, probe) +
    submit(3, 1, 3, 512) + submit(4, 1, 3, 512) + control(5, 0x21, 1, 0x200, 0x101, 1, b"\1") +
    control(6, 0x21, 1, 0x400, 0x101, 4, struct.pack("<I", 40)) + control(7, 0x21, 1, 0x400, 0x201, 2, struct.pack("<H", 32)) +
    submit(8, 1, 3, 512),
}
folder = pathlib.Path(sys.argv[1])
folder.mkdir(parents=True, exist_ok=True)
for name, stream in streams.items():
    (folder / name).write_bytes(stream)
