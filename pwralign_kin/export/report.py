"""One page for people: the picture, the joints and how far the scan is from the model; a file that goes anywhere."""

from __future__ import annotations

import json
from base64 import b64encode
from collections.abc import Iterable, Sequence
from html import escape
from importlib.metadata import version
from pathlib import Path

import numpy as np

from pwralign_kin import files
from pwralign_kin.estimation.result import Estimate, millimetres, shown
from pwralign_kin.export.deviation import Figures
from pwralign_kin.model import ArticulatedModel
from pwralign_kin.scan import Scan
from pwralign_kin.se3 import placement_text

DOUBTFUL = 0.5
"""Confidence below which the page warns, as the command line does."""

_STYLE = """
:root { color-scheme: light dark; --line: #8884; --pale: #888; --mark: #2f7de1; --warn: #c22f1e; }
body { font: 15px/1.5 system-ui, sans-serif; max-width: 62rem; margin: 2rem auto; padding: 0 1.2rem; }
h1 { font-size: 1.6rem; margin: 0; } h2 { font-size: 1.1rem; margin: 2rem 0 .4rem; }
p { margin: .4rem 0; } .pale { color: var(--pale); } .warn { color: var(--warn); font-weight: 600; }
img { width: 100%; background: #fff; border: 1px solid var(--line); border-radius: 8px; margin-top: 1rem; }
table { border-collapse: collapse; width: 100%; font-variant-numeric: tabular-nums; }
th { text-align: left; font-weight: 600; color: var(--pale); } .n { text-align: right; white-space: nowrap; }
td, th { padding: .25rem .8rem .25rem 0; border-bottom: 1px solid var(--line); }
meter { width: 8rem; vertical-align: middle; } th:empty { width: 8rem; }
code { font-size: .9em; overflow-wrap: anywhere; }
@media print { body { margin: 0; } }
"""


def write_report(
    path: Path,
    model: ArticulatedModel,
    estimate: Estimate,
    scan: Scan,
    figures: Sequence[Figures | None],
    picture: Path,
) -> None:
    """Write an HTML page without scripts that loads nothing: `picture` (PNG) is in it.

    `figures` are those of the scan's distances to each part of the model.
    """
    source, urdf = Path(scan.source).name, Path(model.urdf_path).name
    known = "visible" if estimate.viewpoint_known else "whole"
    sections = [
        f"<h1>{escape(model.name)}</h1>",
        f'<p class="pale">{escape(urdf)} in {escape(source)}, {len(scan)} points</p>',
        f"<p>{_verdict(estimate)}</p>",
        f"<p>{estimate.scan_coverage:.1%} of the scan lies on the model; {estimate.model_support:.1%} of the {known} "
        "model is seen.</p>",
        f'<img alt="the posed model over the scan" src="data:image/png;base64,{_base64(picture)}">',
        "<h2>Joints</h2>",
        _table(("joint", "#value", "#standard deviation", "#from", "", "to"), _joints(model, estimate)),
        "<h2>Distance of the scan to the model</h2>",
        '<p class="pale">Above 0: in front of the surface. 95%: as far as 95 of 100 points at most.</p>',
        _table(("part", "#points", "#mean", "#RMS", "#95%", "#largest"), _parts(model, figures)),
        "<h2>Where and how</h2>",
        f"<p>Link {escape(model.root_link)} in the scan frame: "
        f"<code>{placement_text(estimate.state.T_scan_base, 4)}</code></p>",
        f'<p class="pale">pwralign-kin {version("pwralign-kin")}, {_options(estimate)}. '
        "All figures: estimate.json.</p>",
    ]
    page = "\n".join(sections)
    head = f'<meta charset="utf-8"><title>{escape(model.name)} in {escape(source)}</title><style>{_STYLE}</style>'
    files.write_text(path, f'<!doctype html>\n<html lang="en"><head>{head}</head>\n<body>\n{page}\n</body></html>\n')


def _verdict(estimate: Estimate) -> str:
    """Return how far the answer is to be trusted, in a sentence or three."""
    sure = f"Confidence {estimate.confidence:.2f}: the chance that the model lies over the scan as shown."
    said = [f"<b>{sure}</b>"]
    if estimate.confidence < DOUBTFUL:
        said = [f'<span class="warn">{sure} Do not rely on it without a look at the picture.</span>']
    if estimate.undetermined:
        said.append(f"The scan does not tell {escape(', '.join(estimate.undetermined))}.")
    equal = sum(other.equal for other in estimate.alternatives)
    if equal:
        answers = "One other answer explains" if equal == 1 else f"{equal} other answers explain"
        said.append(f"{answers} the scan as well: see the alternatives in estimate.json.")
    return " ".join(said)


def _options(estimate: Estimate) -> str:
    told = json.dumps(dict(estimate.options))
    return f"options <code>{escape(told)}</code>" if estimate.options else "default options"


def _joints(model: ArticulatedModel, estimate: Estimate) -> Iterable[tuple[str, ...]]:
    """Yield the cells of a row for each joint."""
    for name, low, high in zip(model.joint_names, model.lower.tolist(), model.upper.tolist(), strict=True):
        value, unit, told = estimate.state.joints[name], estimate.units[name], name not in estimate.undetermined
        std = shown(estimate.std[name], unit, 0, 2) if told else "undetermined"
        share = np.clip((value - low) / (high - low), 0.0, 1.0) if high > low else 0.0
        cells = (shown(value, unit, 0, 2), std, shown(low, unit, 0, 0), shown(high, unit, 0, 0))
        value_text, std_text, low_text, high_text = (cell.strip().replace(" deg", "°") for cell in cells)
        if told:
            meter = f'<meter value="{share:.3f}"></meter>'
            yield escape(name), value_text, f"± {std_text}", low_text, meter, high_text
        else:
            yield escape(name), f'<span class="pale">({value_text})</span>', std_text, low_text, "", high_text


def _parts(model: ArticulatedModel, figures: Sequence[Figures | None]) -> Iterable[tuple[str, ...]]:
    """Yield the cells of a row for each part with geometry."""
    for part, own in zip(model.parts, figures, strict=True):
        if own is not None:
            lengths = (own.mean, own.rms, own.p95_abs, own.max_abs)
            yield escape(part.name), str(own.points), *map(millimetres, lengths)
        elif len(part.faces):
            yield escape(part.name), "0", "", "", "", ""


def _table(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table of cells in HTML; a head that begins with # marks a column of figures."""
    kinds = [' class="n"' if head.startswith("#") else "" for head in heads]
    lines = ["<tr>" + "".join(f"<th{kind}>{head.lstrip('#')}</th>" for kind, head in zip(kinds, heads, strict=True))]
    lines += ("<tr>" + "".join(f"<td{kind}>{cell}</td>" for kind, cell in zip(kinds, row, strict=True)) for row in rows)
    return "<table>\n" + "\n".join(lines) + "\n</table>"


def _base64(path: Path) -> str:
    return b64encode(path.read_bytes()).decode("ascii")
