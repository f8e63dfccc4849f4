"""Aligns two scans by this project and by the package small_gicp, turn by turn in one run.

Arguments: the binary `starling`, the folder of `lidar_pair`, and how often. Both sides thin to
0.25 m, start from the identity and use one thread; a figure is the median over the turns. In each
turn both do it a few times, so that the first time in a process, which is slower, does not count;
how long that takes is a row of its own.
"""

import json
import statistics
import subprocess
import sys
import time

import numpy as np
import small_gicp

VOXEL_M = 0.25
# In each turn.
REPEATS = 5
METRICS = [("gicp", "GICP"), ("plane", "PLANE_ICP"), ("point", "ICP")]


def read_ply(path):
    """The points of a binary PLY whose properties are all `float`, x, y and z first."""
    content = open(path, "rb").read()
    marker = b"end_header\n"
    start = content.index(marker) + len(marker)
    header = content[:start].decode().splitlines()
    width = sum(line.startswith("property float") for line in header)
    values = np.frombuffer(content[start:], "<f4").reshape(-1, width)
    return values[:, :3].astype(float)


def errors(estimate, truth):
    """Metres and degrees; the truth's digits are few, so its rotation is made one first."""
    left, _, right = np.linalg.svd(truth[:3, :3])
    between = (left @ right).T @ estimate[:3, :3]
    axis = [between[2, 1] - between[1, 2], between[0, 2] - between[2, 0], between[1, 0] - between[0, 1]]
    metres = np.linalg.norm(estimate[:3, 3] - truth[:3, 3])
    return metres, np.degrees(np.arcsin(np.linalg.norm(axis) / 2))


def align_by_peer(source, target, kind):
    """The middle one of a few."""
    results = [align_once_by_peer(source, target, kind) for _ in range(REPEATS)]
    times = np.median([times_ms for _, times_ms, _ in results], axis=0)
    return results[0][0], list(times), results[0][2]


def align_once_by_peer(source, target, kind):
    started = time.perf_counter()
    fixed, tree = small_gicp.preprocess_points(
        target, downsampling_resolution=VOXEL_M, num_threads=1
    )
    moved, _ = small_gicp.preprocess_points(
        source, downsampling_resolution=VOXEL_M, num_threads=1
    )
    prepared = time.perf_counter()
    result = small_gicp.align(fixed, moved, tree, registration_type=kind, num_threads=1)
    done = time.perf_counter()
    times_ms = [(prepared - started) * 1e3, (done - prepared) * 1e3]
    return result.T_target_source, times_ms, result.iterations


def align_by_us(binary, folder, metric, repeats):
    command = [binary, "register", folder + "/source.ply", folder + "/target.ply"]
    command += ["--metric", metric, "--voxel", str(VOXEL_M), "--json"]
    command += ["--repeat", str(repeats)]
    output = subprocess.run(command, stdout=subprocess.PIPE, check=True).stdout
    result = json.loads(output)
    times_ms = [result["ms_preprocess"], result["ms_align"]]
    return np.array(result["target_from_source"]), times_ms, result["iterations"]


def main():
    binary, folder, turns = sys.argv[1], sys.argv[2], int(sys.argv[3])
    source, target = (read_ply(f"{folder}/{name}.ply") for name in ("source", "target"))
    truth = np.loadtxt(folder + "/T_target_source.txt")
    print("| metric | who | error | iterations | prepare | align | total |")
    print("|---|---|---|---|---|---|---|")
    for metric, kind in METRICS:
        runs = {"starling": [], "small_gicp": [], "starling, first": []}
        for _ in range(turns):
            runs["starling"].append(align_by_us(binary, folder, metric, REPEATS))
            runs["starling, first"].append(align_by_us(binary, folder, metric, 1))
            runs["small_gicp"].append(align_by_peer(source, target, kind))
        medians = {}
        for who, results in runs.items():
            estimate, _, iterations = results[0]
            times = np.array([times_ms for _, times_ms, _ in results])
            prepare, align, total = (
                statistics.median(column) for column in (*times.T, times.sum(1))
            )
            medians[who] = (prepare, align, total)
            metres, degrees = errors(estimate, truth)
            print(
                f"| {metric} | {who} | {metres:.4f} m, {degrees:.3f}° | {iterations} "
                f"| {prepare:.1f} ms | {align:.1f} ms | {total:.1f} ms |"
            )
        pairs = zip(medians["starling"], medians["small_gicp"])
        ratios = [ours / theirs for ours, theirs in pairs]
        print(f"| {metric} | ratio | | | " + " | ".join(f"{ratio:.2f}" for ratio in ratios) + " |")


main()
