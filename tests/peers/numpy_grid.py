#!/usr/bin/env python3
"""The paper's grid search over theta in NumPy, as a peer for `palpate bench sweep`.

Reads the precomputed signals that `palpate bench sweep --peer DIR` writes (see `palpate_calibration::bench`) and
searches the same grid on them. It does what a careful NumPy user would do:

- propagated pressure once per alpha, as one BLAS product per patch, with arrays laid out for it beforehand;
- events compared as whole arrays, mismatches counted by `count_nonzero` on bool arrays;
- no memory allocated inside the loops;
- by default each modality is compared once per value of its own threshold, since the mismatch at a point of the grid
  is the sum of its two parts (`--every-point` compares both at each of the grid's points instead, as a direct
  reading of the paper would).

On a busy machine BLAS threads wait for each other: OPENBLAS_NUM_THREADS=1 can be the faster setting; report the better.

Usage: numpy_grid.py DIR [--repeats N] [--every-point]; prints one JSON document. Needs NumPy only.
"""

import argparse
import json
import time
from pathlib import Path

import numpy as np


def load(folder):
    """Arrays of the export, pressure patches as (pressures, node distances, real events)."""
    patches = []
    while (folder / f"pressures_{len(patches)}.npy").exists():
        k = len(patches)
        patches.append(
            tuple(
                np.load(folder / f"{name}_{k}.npy")
                for name in ("pressures", "node_distances", "real_pressure")
            )
        )
    names = ("distances", "real_proximity", "alphas", "lambda_cons", "lambda_pres")
    return patches, *(np.load(folder / f"{name}.npy") for name in names)


class Grid:
    def __init__(self, folder):
        self.patches, self.distances, self.real_proximity, self.alphas, self.cons, self.pres = load(folder)
        channels = [real.shape[1] for _, _, real in self.patches]
        self.columns = np.cumsum([0, *channels])
        frames = self.distances.shape[0]
        self.real_pressure = (
            np.hstack([real for _, _, real in self.patches]) if self.patches else np.zeros((frames, 0), bool)
        )
        # One row a node: the product below reads memory in order then, and is several times faster for it.
        self.pressures = [np.ascontiguousarray(pressures.T) for pressures, _, _ in self.patches]
        self.signal = np.empty((self.columns[-1], frames))
        self.real_pressure = np.ascontiguousarray(self.real_pressure.T)
        self.events = np.empty_like(self.real_pressure)
        self.near = np.empty_like(self.real_proximity)

    def propagate(self, alpha):
        """Propagated pressure of every pressure channel, one row a channel."""
        for k, (_, node_distances, _) in enumerate(self.patches):
            rows = self.signal[self.columns[k] : self.columns[k + 1]]
            np.matmul(np.exp(-alpha * node_distances), self.pressures[k], out=rows)

    def pressure_l1(self, lambda_pre):
        np.greater(self.signal, lambda_pre, out=self.events)
        np.not_equal(self.events, self.real_pressure, out=self.events)
        return int(np.count_nonzero(self.events))

    def proximity_l1(self, lambda_con):
        np.less(self.distances, lambda_con, out=self.near)
        np.not_equal(self.near, self.real_proximity, out=self.near)
        return int(np.count_nonzero(self.near))

    def search(self):
        """Best (L1, theta); each part of the objective once per value of its own threshold."""
        by_con = [self.proximity_l1(lambda_con) for lambda_con in self.cons]
        best = None
        for alpha in self.alphas:
            self.propagate(alpha)
            for lambda_pre in self.pres:
                pressure = self.pressure_l1(lambda_pre)
                for lambda_con, proximity in zip(self.cons, by_con):
                    if best is None or pressure + proximity < best[0]:
                        best = (pressure + proximity, lambda_con, alpha, lambda_pre)
        return best

    def search_every_point(self):
        """Best (L1, theta); both parts compared at each point."""
        best = None
        for alpha in self.alphas:
            self.propagate(alpha)
            for lambda_pre in self.pres:
                for lambda_con in self.cons:
                    l1 = self.pressure_l1(lambda_pre) + self.proximity_l1(lambda_con)
                    if best is None or l1 < best[0]:
                        best = (l1, lambda_con, alpha, lambda_pre)
        return best


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--every-point", action="store_true")
    arguments = parser.parse_args()
    grid = Grid(arguments.folder)
    search = grid.search_every_point if arguments.every_point else grid.search
    seconds = []
    for _ in range(arguments.repeats):
        start = time.perf_counter()
        l1, lambda_con, alpha, lambda_pre = search()
        seconds.append(time.perf_counter() - start)
    report = {
        "seconds": min(seconds),
        "l1": l1,
        "theta": {"lambda_con_m": lambda_con, "alpha_per_m": alpha, "lambda_pre_pa": lambda_pre},
        "points": len(grid.alphas) * len(grid.cons) * len(grid.pres),
        "every_point": arguments.every_point,
        "frames": grid.distances.shape[0],
        "numpy": np.__version__,
    }
    print(json.dumps(report, indent=1))


if __name__ == "__main__":
    main()
