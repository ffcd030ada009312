"""`python -m benchmarks.peers NAME NETWORK STEPS FOLDER`: one run of one peer; the folder receives the results."""

from __future__ import annotations

import argparse
import json
import os
import time
from pathlib import Path

import numpy as np

from benchmarks.peers import PEERS
from benchmarks.peers.network import BEGAN, Network
from hedgerow.wire.runtime import share_the_cores


def main() -> None:
    """Run, and write trajectory.npz and then done.json."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("name", choices=PEERS)
    parser.add_argument("network", type=Path, help="what Network.write wrote")
    parser.add_argument("steps", type=int)
    parser.add_argument("folder", type=Path)
    known = parser.parse_args()
    os.environ.setdefault(BEGAN, str(time.monotonic()))
    share_the_cores()
    done = PEERS[known.name].run(Network.read(known.network), known.steps)
    np.savez(known.folder / "trajectory.npz", x=done.x, u=done.u)
    numbers = {"steps_per_s": done.steps_per_s, "first_step_s": done.first_step_s, "pss_mb": done.pss_mb}
    used = [[*thread, *numbers] for thread, numbers in done.used.items()]
    (known.folder / "used.json").write_text(json.dumps(used), encoding="utf-8")
    (known.folder / "done.json").write_text(json.dumps(numbers), encoding="utf-8")


if __name__ == "__main__":
    main()
