"""One large reconstruction in a process of its own, for its peak memory.

python -m extremal.app.studies._network_scale EVENTS GAP SEED

All events of the network of 29 agents have lost one participant. Prints slots, seconds of the processor and peak memory
as JSON.
"""

from __future__ import annotations

import json
import sys
import time

from extremal.hawkes.reconstruct import reconstruct

from ..record import peak_memory
from ._network_runs import Data, seed_of
from .table_3_2 import surrogate


def main(events: int, gap: float, seed: int) -> None:
    """Simulate, build the slots, solve (3.5), report."""
    began = time.process_time()
    slots, _ = Data(surrogate(), events, events).slots(seed_of(seed))
    ready = time.process_time()
    result = reconstruct(slots, gap=gap)
    done = time.process_time()
    report = {
        "slots": len(slots),
        "before": ready - began,
        "seconds": done - ready,
        "relative_gap": result.relative_gap,
        "bytes": peak_memory(),
    }
    print(json.dumps(report))


if __name__ == "__main__":
    main(int(sys.argv[1]), float(sys.argv[2]), int(sys.argv[3]))
