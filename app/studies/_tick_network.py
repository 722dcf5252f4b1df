"""Simulation by tick (Bacry et al. 2018), the neighbour of `extremal study hawkes-cost`.

    PYTHON _tick_network.py TIMELINES EVENTS    with an interpreter that has tick; it needs nothing of this package

Timelines do not excite each other, parameters are those of section 3.4; prints seconds of the processor as JSON.
"""

import json
import sys
import time
from importlib.metadata import version

import numpy as np
from tick.hawkes import SimuHawkesExpKernels


def main(timelines, events):
    """Simulate three times and report the fastest."""
    seconds = []
    for seed in range(1, 4):
        process = SimuHawkesExpKernels(
            adjacency=0.5 * np.eye(timelines),
            decays=0.1,
            baseline=np.full(timelines, 0.01),
            max_jumps=events,
            verbose=False,
            seed=seed,
        )
        began = time.process_time()
        process.simulate()
        seconds.append((time.process_time() - began) / process.n_total_jumps)
    print(json.dumps({"version": version("tick"), "seconds_per_event": min(seconds)}))


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
