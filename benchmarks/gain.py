"""The processor time that the bounds on the gain take, by size and kind of network: `python -m benchmarks.gain`."""

from __future__ import annotations

import argparse
import time
from typing import Any

import hedgerow as hg
from hedgerow.orchestrator.metrics.gain_bound import Method, Premise, bound, method_for
from hedgerow.orchestrator.metrics.gain_certificate import GainCertificate
from hedgerow.orchestrator.metrics.guarantee import plant_of
from hedgerow.topologies.errors import HedgerowError
from hedgerow.topologies.named import Named

KINDS: dict[str, dict[str, object]] = {
    "tree": {"kind": "random_tree", "max_degree": 3},
    "ring": {"kind": "ring"},
    "regular": {"kind": "random_regular", "degree": 3},
}


def cost(name: str, network: Named) -> None:
    """Print the time that the certificate takes per step of a run in one process, and its share of the whole run."""
    own, take = [0.0], GainCertificate.take

    def timed(*arguments: Any) -> Any:
        began = time.perf_counter()
        try:
            return take(*arguments)
        finally:
            own[0] += time.perf_counter() - began

    hg.simulate(network)  # the bounds of the second run are known, and its modules are loaded
    setattr(GainCertificate, "take", timed)  # noqa: B010 (mypy knows no other way)
    try:
        began = time.perf_counter()
        run = hg.simulate(network)
        took = time.perf_counter() - began
    finally:
        setattr(GainCertificate, "take", take)  # noqa: B010
    print(f"{name}: {1e3 * own[0] / run.T:.3f} ms of {1e3 * took / run.T:.3f} ms per step, {100 * own[0] / took:.1f} %")


def costs() -> None:
    """Print the cost of the certificate in paper7 and in a tree of 10,000 nodes."""
    cost("paper7", hg.load("paper7", steps=20_000))
    tree = {"kind": "random_tree", "max_degree": 3, "nodes": 10_000}
    lists = {"candidates": [0.2, 0.5, 0.8]}
    cost("tree of 10,000", {"name": "tree", "b": 0.1, "steps": 200, "seed": 1, "graph": tree, "defaults": lists})


def main() -> None:
    """Print one line per network and premise."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sizes", default="100,300,1000")
    parser.add_argument("--kinds", default=",".join(KINDS))
    parser.add_argument("--premises", default="estimates,edges")
    parser.add_argument("--whole", action="store_true", help="the program with one matrix too")
    parser.add_argument("--limit", type=float, default=170.0, help="seconds per bound")
    parser.add_argument("--cost", action="store_true", help="the time of the certificate per step of a run, instead")
    options = parser.parse_args()
    if options.cost:
        costs()
        return
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
                        text = f"gain {found.gain:.5f} margin {found.margin:.1g}"
                    except HedgerowError as error:
                        text = str(error)
                    took = time.process_time() - began
                    print(f"{kind:8} n {n:6} {premise:9} {method:5} {took:7.2f} s  {text}", flush=True)


if __name__ == "__main__":
    main()
