"""Lists the maps of a running team and decodes one chunk: pip install eclipse-zenoh cbor2 numpy.

usage: list_maps.py tcp/127.0.0.1:PORT
"""
import json
import sys

import cbor2
import numpy
import zenoh

config = {"mode": "client", "connect": {"endpoints": [sys.argv[1]]}}
session = zenoh.open(zenoh.Config.from_json5(json.dumps(config)))


def get(selector):
    replies = session.get(selector, consolidation=zenoh.ConsolidationMode.NONE, timeout=5.0)
    return [(str(r.ok.key_expr), cbor2.loads(bytes(r.ok.payload))) for r in replies if r.ok]


for key, manifest in get("anchor/*/map"):
    rests_on = manifest.get("provenance")  # only of maps that are registered to others
    print(key, manifest["epoch"], manifest["chunk_count"], "chunks; held by", manifest["holder"],
          *(["; registered, rests on", *rests_on] if rests_on else []))

key, chunk = get("anchor/*/map/*/*")[0]
steps = numpy.frombuffer(chunk["points"].value, "<u2").reshape(-1, 3)
x, y, log_z = (chunk["start"] + steps * chunk["step"]).T
points = numpy.exp(log_z)[:, None] * numpy.stack([x, y, numpy.ones_like(x)], axis=1)
print(key, points.shape, "points in the keyframe's camera; the median is", numpy.median(points, axis=0))
session.close()
