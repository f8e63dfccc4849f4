"""Decodes a chunk from stdin to an N×3 array and prints its rows: all that a client needs."""
import sys

import cbor2
import numpy as np

payload = sys.stdin.buffer.read()

chunk = cbor2.loads(payload)
grid = np.frombuffer(chunk["points"].value, "<u2").reshape(-1, 3) * chunk["step"] + chunk["start"]
points = np.c_[grid[:, :2], np.ones(len(grid))] * np.exp(grid[:, 2:])

sigma = points[:, 2] * 2.0 ** (np.frombuffer(chunk["sigma"].value, "u1") / 16 - 14)
descriptors = np.frombuffer(chunk["descriptors"].value, "u1").reshape(-1, 32)
for point, deviation, descriptor in zip(points, sigma, descriptors):
    print(*point, deviation, descriptor.tobytes().hex())
