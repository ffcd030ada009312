"""The processor time of the bounds on the gain, by size and kind of network: `python -m benchmarks.gain`."""

from __future__ import annotations

import argparse
import time

import hedgerow as hg
from hedgerow.orchestrator.metrics.gain_bound import Method, Premise, bound, method_for
from hedgerow.orchestrator.metrics.guarantee import plant_of
from hedgerow.topologies.errors import HedgerowError

KINDS: dict[str, dict[str, object]] = {
    "tree": {"kind": "random_tree", "max_degree": 3},
    "ring": {"kind": "ring"},
    "regular": {"kind": "random_regular", "degree": 3},
}


def main() -> None:
    """Print one line per network and premise."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sizes", default="100,300,1000")
    parser.add_argument("--kinds", default=",".join(KINDS))
    parser.add_argument("--premises", default="estimates,edges")
    parser.add_argument("--whole", action="store_true", help="the program with one matrix too")
    parser.add_argument("--limit", type=float, default=170.0, help="seconds per bound")
    options = parser.parse_args()
    for kind in options.kinds.split(","):
        for n in map(int, options.sizes.split(",")):
            graph = {**KINDS[kind], "nodes": n}
            lists = {"candidates": [0.2, 0.5, 0.8]}
            network = {"name": kind, "b": 0.1, "steps": 1, "seed": 1, "graph": graph, "defaults": lists}
            plant = plant_of(hg.load(network).network)
            for premise in map(Premise, options.premises.split(",")):
                methods = {method_for(plant, premise), *([Method.WHOLE] if options.whole else [])}
                for method in sorted(methods):
                    began = time.process_time()
                    try:
                        found = bound(plant, premise, method, options.limit)
                        said = f"gain {found.gain:.5f} margin {found.margin:.1g}"
                    except HedgerowError as error:
                        said = str(error)
                    took = time.process_time() - began
                    print(f"{kind:8} n {n:6} {premise:9} {method:5} {took:7.2f} s  {said}", flush=True)


if __name__ == "__main__":
    main()
