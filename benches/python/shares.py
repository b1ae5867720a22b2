"""What the shares of a picture cost, and what it gains to begin with those that a coarse picture says take longest.

    python benches/python/shares.py scene.json [EDGE] [SAMPLES]

Renders each share in this process, in one thread, and takes its CPU time; then computes how long so many threads would take for all of them,
each taking the next share when it is done, as a multiple of the time if none ever waited.
"""

import heapq
import sys
import time
from pathlib import Path

import numpy as np

import rayset as rs
from rayset import _native
from rayset._executor.pictures import _AT_ONCE, _PROBE


def cpu(work):
    begun = time.process_time()
    made = work()
    return time.process_time() - begun, made


def span(order, threads, costs):
    free = [0.0] * threads
    for share in order:
        heapq.heappush(free, heapq.heappop(free) + costs[share])
    return max(free) * threads / sum(costs)


def main(path, edge=512, samples=2):
    scene = rs.Scene.load(path).to_json()
    scene.setdefault("image", {}).update(size=[edge, edge], samples=samples)
    job = rs.Scene.from_json(scene, Path(path).parent)._job(None, True)
    with rs.Session(threads=1) as session:
        def share(number, of, square=1):
            return cpu(lambda: _native.render_part(session._native, job, (number, of), None, square))

        share(1, 1, _PROBE)
        probe, part = share(1, 1, _PROBE)
        seen = 1.0 + _native.join_parts([("coarse", part)]).layer("samples")
        for of in (16, 32, 64):
            costs = [share(number, of)[0] for number in range(1, of + 1)]
            told = _native.share_costs(seen.ravel().tolist(), [0, 0, edge, edge], _PROBE, of)
            print(f"{of} shares: {sum(costs):.2f} s, the largest {max(costs) * of / sum(costs):.2f} of the mean; the coarse picture "
                  f"{100 * probe / sum(costs):.1f} %, correlation {np.corrcoef(costs, told)[0, 1]:.2f}")
            for threads in (2, 4, 8):
                first = _AT_ONCE * threads
                heaviest = [*range(min(first, of)), *sorted(range(first, of), key=lambda k: -told[k])]
                print(f"  {threads} threads: as numbered {span(range(of), threads, costs):.3f}, heaviest first {span(heaviest, threads, costs):.3f}")


if __name__ == "__main__":
    main(sys.argv[1], *map(int, sys.argv[2:]))
