"""The map of a country: what reading and storing its motorways takes.

`python -m tests.benchmarks.bench_maps [WAYS]` draws a map of so many ways (a million by default,
which takes a few minutes) with eight nodes each, reads it, and prints time and memory.
"""

from __future__ import annotations

import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import osmium

RUN = "import sys; from egolane_pgm.maps.osm import read_osm; read_osm(sys.argv[1])"

#: Ways of one road, one behind the other, and nodes of a way.
ROAD, NODES = 200, 8

#: Numbers of lanes along a road.
LANES = (4, 3, 3, 4, 3, 2, 4, 2)


def write_country(path: Path, n_ways: int) -> None:
    """Write an extract of winding roads, whose node ids are spread as widely as real ones."""
    rng = np.random.default_rng(0)
    n_roads = n_ways // ROAD
    size = ROAD * NODES + 1
    node = np.cumsum(rng.integers(1, 3000, (n_roads, size))).reshape(n_roads, size).tolist()
    with osmium.SimpleWriter(str(path), overwrite=True) as file:
        for ids in node:
            heading = rng.uniform(0, 2 * np.pi) + np.cumsum(rng.normal(0, 0.03, size))
            east = 6 + 9 * rng.random() + np.cumsum(np.cos(heading)) * 50 / 70_000
            north = 47 + 8 * rng.random() + np.cumsum(np.sin(heading)) * 50 / 111_000
            for one, place in zip(
                ids, zip(east.tolist(), north.tolist(), strict=True), strict=True
            ):
                file.add_node(osmium.osm.mutable.Node(id=one, location=place))
        for k in range(n_roads * ROAD):
            road, nth = divmod(k, ROAD)
            n_lanes = LANES[nth % len(LANES)]
            tags = {"highway": "motorway", "lanes": str(n_lanes), "ref": f"A {road % 900}"}
            tags |= {"oneway": "yes", "maxspeed": "130", "lit": "no", "surface": "asphalt"}
            line = node[road][nth * NODES : (nth + 1) * NODES + 1]
            file.add_way(osmium.osm.mutable.Way(id=k + 1, nodes=line, tags=tags))


def measured(what: str, *words: str) -> str:
    """A line of Markdown: time of the clock and of the processor, and the largest memory so far."""
    begun, before = time.perf_counter(), resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run([sys.executable, "-c", RUN, *words], check=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    own = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    clock = time.perf_counter() - begun
    return f"| {what} | {clock:.1f} s | {own:.1f} s | {after.ru_maxrss / 2**20:.2f} GiB |"


def main(n_ways: int) -> None:
    with tempfile.TemporaryDirectory() as folder:
        roads = Path(folder) / "roads.osm.pbf"
        write_country(roads, n_ways)
        row = measured("read", str(roads))
    print(f"| {n_ways:,} ways | time | of the processor | largest memory so far |")
    print("|---|---:|---:|---:|")
    print(row)


if __name__ == "__main__":
    main(int(sys.argv[1]) if sys.argv[1:] else 1_000_000)
