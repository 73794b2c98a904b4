"""Write logs of robots with hidden effects: ``python benchmarks/hidden_effects FOLDER --robots planar2``."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from multiprocessing import Pool
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from hidden_effects.cases import write_case
from hidden_effects.effects import MAGNITUDES
from hidden_effects.plans import KINDS, Case, cases, numbers
from hidden_effects.robots import ROBOTS


def _write(task: tuple[Case, Path]) -> str:
    case, folder = task
    try:
        write_case(case, folder / case.name)
    except RuntimeError as error:
        return f"{case.name}: {error}"
    return case.name


def main(arguments: Sequence[str] | None = None) -> None:
    """Write cases."""
    parser = argparse.ArgumentParser(description="Write logs of robots with hidden effects.")
    parser.add_argument("folder", type=Path)
    parser.add_argument("--kind", default="single", help=f"of {', '.join(KINDS)}; several with commas")
    parser.add_argument("--robots", default=",".join(ROBOTS))
    parser.add_argument("--effects", default="", help="only cases in which one of these is hidden")
    parser.add_argument("--magnitudes", default=",".join(MAGNITUDES))
    parser.add_argument("--seeds", default="0", help="such as 0,3-5")
    parser.add_argument("--seconds", type=float, default=30.0)
    parser.add_argument("--jobs", type=int, default=2)
    options = parser.parse_args(arguments)
    chosen = [
        case
        for kind in options.kind.split(",")
        for case in cases(
            kind,
            options.robots.split(","),
            options.magnitudes.split(","),
            numbers(options.seeds),
            options.seconds,
        )
        if not options.effects or {one.effect for one in case.hidden} & set(options.effects.split(","))
    ]
    with Pool(options.jobs) as pool:
        for name in pool.imap_unordered(_write, [(case, options.folder) for case in chosen]):
            print(name, flush=True)


if __name__ == "__main__":
    main()
