"""Pictures of a posed model and a scan, drawn by ray casting: no display, window system or GPU is needed."""

from pwralign_kin.render.camera import View
from pwralign_kin.render.colours import part_colours, to_linear
from pwralign_kin.render.drawing import POINT_FAR, POINT_NEAR, Drawing, draw, drawable, drawing, render, splat
from pwralign_kin.render.mesh import PosedMesh, corner_normals, distinct_rows, posed_mesh
from pwralign_kin.render.rays import Hits, RayScene
from pwralign_kin.render.shading import stripes
from pwralign_kin.render.views import default_views, frame_of, overview, refitted

__all__ = [
    "POINT_FAR", "POINT_NEAR", "Drawing", "Hits", "PosedMesh", "RayScene", "View", "corner_normals", "default_views",
    "distinct_rows", "draw", "drawable", "drawing", "frame_of", "overview", "part_colours", "posed_mesh", "refitted",
    "render", "splat", "stripes", "to_linear",
]  # fmt: skip
