"""`python -m makers.pages PAGE...`: pages of results/ that compare runs of the paper's recordings.

`paper` is other graphs with the paper's parameters (a minute), `tuned` the paper's parameters
searched for each run (three minutes), and `beyond` position in lane and the paper's graph (five
minutes). Results are kept in results/runs; a row of a table of runs that has one is skipped. Needs
EGOLANE_DATA.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import egolane_pgm as ego
from egolane_pgm.paper import load_published, paper_experiment, parameters_for
from egolane_pgm.scoring.scores import SCORES
from egolane_pgm.tools.files import write_text
from egolane_pgm.verbs import compare
from egolane_pgm.views.tables import page, table

RESULTS = Path("results")
RUNS = RESULTS / "runs"

#: The paper's ten recordings, a row each.
RECORDINGS = ego.experiments_folder() / "paper" / "recordings.csv"

#: Graphs with the paper's parameters.
WITH_PAPERS = ("sensor_failure", "wor_on_lane", "no_wor", "lane_only")


def on_recordings(folder: str, experiment: str, overrides: Any = ()) -> Path:
    """Run an experiment on the ten recordings, each block held out; return the folder.

    - folder: of the results, in results/runs.
    """
    place = RUNS / folder
    given = {"overrides": overrides, "held_out": True}
    done = ego.run(experiment, table=RECORDINGS, out=place, jobs=2, **given)
    for name, error in done["error"].dropna().items():
        raise ego.InputError(f"{name}: {error}")
    return place


def compared(
    heading: str, folders: Sequence[Path], *, detector: bool = False, events: bool = False
) -> str:
    """A comparison of folders of results: means over the recordings, then each recording.

    - events: show the scores of lane changes.
    """
    found = ego.compare(folders, of="folder", detector=detector)
    left_out = tuple({*SCORES} - {"accuracy", "f1", "log_loss", "log_evidence"})
    left_out += ("event_",) * (not events)
    found = found.drop(columns=[c for c in found if str(c).startswith(left_out)])
    each = ego.compare(folders, of="folder", by="name", detector=detector)
    order = each.index.get_level_values("folder").unique()
    table_of_each = page([table(each["accuracy"].unstack()[order])], style="wide")
    parts = [heading, compare.text(found, "wide"), "Accuracy on each recording:"]
    return "\n\n".join([*parts, table_of_each])


def paper() -> None:
    """Write results/paper/graphs.md: other graphs with the parameters of the paper."""
    folders = [RUNS / "paper" / graph for graph in WITH_PAPERS]
    for run, entry in load_published().items():
        changes = {"parameters": parameters_for(entry, "recovered")}
        given = {"overrides": changes, "held_out": True, "figures": False}
        for graph, folder in zip(WITH_PAPERS, folders, strict=True):
            ego.run(paper_experiment(run), graph=graph, out=folder / "*", **given)
    heading = "# Other graphs with the paper's parameters\n\nMade by `make paper`; in-sample."
    write_text(RESULTS / "paper/graphs.md", compared(heading, folders, detector=True) + "\n")


def beyond() -> None:
    """Write results/beyond/runs.md: position in lane and the paper's graph."""
    folders = [on_recordings("beyond/zero_label", "zero_label")]
    folders.append(on_recordings("beyond/learned", "zero_label", {"fit.method": "learn"}))
    folders.append(on_recordings("beyond/paper_tuned", "paper_tuned"))
    heading = "# Position in lane and the paper's graph, held out\n\nMade by `make beyond`; causal."
    write_text(RESULTS / "beyond/runs.md", compared(heading, folders, events=True) + "\n")


def tuned() -> None:
    """Write results/tuning/runs.md: the paper's parameters searched for each run."""
    folders = [RUNS / "tuned/held_out", RUNS / "tuned/in_sample"]
    for run in range(1, 11):
        study = ego.tune(paper_experiment(run), jobs=2)
        assert study.held_out is not None
        study.held_out.save(folders[0] / study.name)
        # Held out, so that it is scored on the same frames: untrusted labels are left out.
        untrusted = {
            "untrusted_frames": ego.load_experiment(paper_experiment(run)).fit.untrusted_frames
        }
        best = {**study.experiment.keys, "name": study.name, "fit": untrusted}
        ego.run(best, held_out=True, out=folders[1] / study.name, figures=False)
    heading = (
        "# The paper's parameters searched for each run\n\nMade by `make tuned`: 3,000 trials a"
        " search, the known values first; held out from scratch."
    )
    write_text(RESULTS / "tuning/runs.md", compared(heading, folders) + "\n")


def main() -> None:
    """Make the pages that are named on the command line."""
    pages = {each.__name__: each for each in (paper, tuned, beyond)}
    parser = argparse.ArgumentParser(prog="python -m makers.pages", description=__doc__)
    parser.add_argument("pages", nargs="+", choices=pages)
    for name in parser.parse_args().pages:
        pages[name]()


if __name__ == "__main__":
    main()
