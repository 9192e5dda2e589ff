"""Build the sample models of `robots/` and their sample scans: the same bytes on every run.

python scripts/build_robots.py [--out FOLDER] [--without-scans] [NAME ...]
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path

from robot_models import cabinet, cubebot, door, excavator, laptop, viking_lander
from robot_models.urdf import Robot

MODELS: dict[str, Callable[[], Robot]] = {
    "cubebot": cubebot.build,
    "viking_lander": viking_lander.build,
    "door": door.build,
    "cabinet": cabinet.build,
    "laptop": laptop.build,
    "excavator": excavator.build,
}


def main() -> None:
    parser = argparse.ArgumentParser(description="Build the sample models and their sample scans.")
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"which of {', '.join(MODELS)}")
    parser.add_argument("--out", type=Path, default=Path(__file__).resolve().parent.parent / "robots")
    parser.add_argument("--without-scans", action="store_true")
    options = parser.parse_args()
    unknown = sorted(set(options.names) - set(MODELS))
    if unknown:
        parser.error(f"no model called {', '.join(unknown)}; there are {', '.join(MODELS)}")
    for name in options.names or MODELS:
        robot = MODELS[name]()
        robot.write(options.out / name)
        triangles = sum(len(mesh.faces) for link in robot.links for mesh in link.meshes.values())
        print(f"{name}: {len(robot.links)} links, {len(robot.joints)} joints, {triangles} triangles")
        if not options.without_scans:
            from robot_models.scans import write_scans

            write_scans(options.out / name)


if __name__ == "__main__":
    main()
