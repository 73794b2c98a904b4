"""Write logs of robots with hidden effects: ``python benchmarks/hidden_effects FOLDER --robots planar2``."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from multiprocessing import Pool
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from hidden_effects.case_files import write_case
from hidden_effects.case_list import FRICTION_HELP, KINDS, NOISE_HELP, Case, list_cases, parse_numbers
from hidden_effects.effects import MAGNITUDES
from hidden_effects.friction import FRICTION_KINDS
from hidden_effects.logs import NOISE_KINDS
from hidden_effects.robots import ROBOTS


def _write(task: tuple[Case, Path]) -> str:
    """Write one case; its name, with the reason if it cannot be simulated."""
    case, folder = task
    try:
        write_case(case, folder / case.name)
    except RuntimeError as error:
        return f"{case.name}: {error}"
    return case.name


def main(arguments: Sequence[str] | None = None) -> None:
    """Write the chosen cases."""
    parser = argparse.ArgumentParser(description="Write logs of robots with hidden effects.")
    parser.add_argument("folder", type=Path)
    parser.add_argument("--kind", default="single", help=f"of {', '.join(KINDS)}; several with commas")
    parser.add_argument("--robots", default=",".join(ROBOTS))
    parser.add_argument("--effects", default="", help="only cases in which one of these is hidden")
    parser.add_argument("--magnitudes", default=",".join(MAGNITUDES))
    parser.add_argument("--seeds", default="0", help="such as 0,3-5")
    parser.add_argument("--seconds", type=float, default=30.0)
    parser.add_argument("--friction", choices=FRICTION_KINDS, help=FRICTION_HELP)
    parser.add_argument("--noise", choices=NOISE_KINDS, help=NOISE_HELP)
    parser.add_argument("--jobs", type=int, default=2)
    options = parser.parse_args(arguments)

    robots, magnitudes = options.robots.split(","), options.magnitudes.split(",")
    cases: list[Case] = []
    for kind in options.kind.split(","):
        seeds = parse_numbers(options.seeds)
        cases += list_cases(kind, robots, magnitudes, seeds, options.seconds, options.friction, options.noise)
    if options.effects:
        wanted = set(options.effects.split(","))
        cases = [case for case in cases if wanted & {effect.effect for effect in case.hidden}]
    with Pool(options.jobs) as pool:
        for name in pool.imap_unordered(_write, [(case, options.folder) for case in cases]):
            print(name, flush=True)


if __name__ == "__main__":
    main()
