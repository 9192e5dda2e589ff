"""Draw docs/overlay.png: a model as its URDF has it, a scan, and what is found, side by side."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

import pwralign_kin as pk
from pwralign_kin.render import default_views, draw, posed_mesh, splat

REPOSITORY = Path(__file__).parents[1]
NAME, SCAN = "viking_lander", "full"
SIZE = (620, 620)
HEADER, MARGIN = 92, 28
INK, PALE = (38, 40, 48), (120, 122, 130)


def main() -> None:
    """Estimate, and write the picture."""
    folder = REPOSITORY / "robots" / NAME
    model = pk.ArticulatedModel.from_urdf(folder / f"{NAME}.urdf")
    scan = pk.Scan.load(folder / "scans" / f"{SCAN}.ply")
    estimate = pk.estimate(model, scan)
    found = posed_mesh(model, estimate.state)
    view = default_views(found, scan, size=SIZE)[0]
    half = (SIZE[0] // 2, SIZE[1] // 2)  # dots of two pixels
    points = np.kron(splat(scan.points, view, half), np.ones((2, 2, 1), dtype=np.uint8))
    points = np.where(points < 255, points // 2, points)  # on white, single dots look pale
    neutral = posed_mesh(model, pk.State(np.eye(4), dict.fromkeys(model.joint_names, 0.0), model.root_link))
    as_written = draw(neutral, default_views(neutral, size=SIZE)[0], size=SIZE)
    panels = {
        ("in: a URDF", f"{len(model.joint_names)} joints, of unknown values"): as_written,
        ("in: a scan", f"{len(scan)} points, no initial guess"): points,
        ("out: its place and every joint", f"confidence {estimate.confidence:.2f}"): draw(found, view, scan, size=SIZE),
    }
    canvas = Image.new("RGB", (len(panels) * SIZE[0], HEADER + SIZE[1]), "white")
    pen = ImageDraw.Draw(canvas)
    for number, ((head, remark), panel) in enumerate(panels.items()):
        left = number * SIZE[0]
        canvas.paste(Image.fromarray(panel), (left, HEADER))
        pen.text((left + MARGIN, 14), head, fill=INK, font=ImageFont.load_default(34))
        pen.text((left + MARGIN, 60), remark, fill=PALE, font=ImageFont.load_default(23))
    canvas.save(REPOSITORY / "docs" / "overlay.png", optimize=True)


if __name__ == "__main__":
    main()
