"""The report: sections on one page that needs nothing beside it, and the same numbers as JSON."""

from __future__ import annotations

import base64
import html
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from sim_bridge.study.section import Cell, Picture, Section, Table

STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; color: #1c1c1c; max-width: 62rem; margin: 2rem auto; padding: 0 1rem; }
h1 { font-size: 1.6rem; }
h2 { font-size: 1.25rem; margin-top: 2.6rem; border-top: 1px solid #ddd; padding-top: 1.2rem; }
h3 { font-size: 1rem; margin: 1.4rem 0 .3rem; }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; font-size: 13px; }
th, td { padding: .25rem .7rem; text-align: right; border-bottom: 1px solid #e4e4e4; white-space: nowrap; }
th:first-child, td:first-child { text-align: left; white-space: normal; min-width: 9rem; }
th { white-space: normal; vertical-align: bottom; }
thead th { border-bottom: 2px solid #999; }
tr.thesis td { background: #f4efe2; font-style: italic; }
figure { margin: 1.2rem 0; } img { max-width: 100%; } figcaption { color: #555; font-size: 13px; }
.method { color: #333; } .differs { border-left: 3px solid #c9a227; padding-left: .9rem; list-style: none; }
.differs li { margin: .3rem 0; } nav a { margin-right: 1rem; } @media (prefers-color-scheme: dark) {
body { background: #17181a; color: #ddd; } .method { color: #bbb; } tr.thesis td { background: #2d2a20; }
th, td { border-color: #333; } h2 { border-color: #333; } img { background: #fff; } a { color: #7db4e8; } }
"""


def write(folder: Path, sections: Sequence[Section], about: Sequence[tuple[str, str]]) -> Path:
    """Write report.html and numbers.json into a folder whose pictures/ is drawn; return the report."""
    data = {"about": dict(about), **{section.number: section.as_data() for section in sections}}
    text = json.dumps(data, indent=1, default=_plain, allow_nan=False)
    (folder / "numbers.json").write_text(text + "\n", encoding="utf-8")
    report = folder / "report.html"
    report.write_text(page(sections, about, folder / "pictures"), encoding="utf-8")
    return report


def page(sections: Sequence[Section], about: Sequence[tuple[str, str]], pictures: Path) -> str:
    """Return the page."""
    links = "".join(f'<a href="#s{s.number}">{s.number} {html.escape(s.title)}</a> ' for s in sections)
    facts = "".join(f"<li>{html.escape(name)}: {html.escape(value)}</li>" for name, value in about)
    body = "".join(_section(section, pictures) for section in sections)
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8"><title>Chapter 7 again</title>'
        f'<meta name="viewport" content="width=device-width"><style>{STYLE}</style></head><body>'
        "<h1>Performance of GLSDC and LHM: chapter 7 of the thesis again</h1><p>The thesis' studies, on flights of "
        "this simulator, beside its printed numbers (set in italics on a tint). OpenCV's SQPNP and EPNP and the chain "
        "that this project flies stand beside its two solvers. The thesis gives neither its camera's data nor its "
        "marker map, so the geometry is not the same; where numbers differ, a sentence says "
        f"why.</p><ul>{facts}</ul><nav>{links}</nav>{body}</body></html>\n"
    )


def _section(section: Section, pictures: Path) -> str:
    differences = "".join(f"<li>{html.escape(text)}</li>" for text in section.differences)
    return (
        f'<h2 id="s{section.number}">{section.number} {html.escape(section.title)}</h2>'
        f'<p class="method">{html.escape(section.method)}</p>'
        + (f'<ul class="differs">{differences}</ul>' if differences else "")
        + "".join(_table(table) for table in section.tables)
        + "".join(_picture(picture, pictures) for picture in section.pictures)
    )


def _table(table: Table) -> str:
    head = "".join(f"<th>{html.escape(column)}</th>" for column in table.columns)
    rows = "".join(
        f"<tr{' class=thesis' if i in table.thesis else ''}>{''.join(f'<td>{cell_text(c)}</td>' for c in row)}</tr>"
        for i, row in enumerate(table.rows)
    )
    return (
        f'<h3>{html.escape(table.title)}</h3><div class="scroll"><table><thead><tr>{head}</tr></thead>'
        f"<tbody>{rows}</tbody></table></div>\n"
    )


def cell_text(cell: Cell) -> str:
    """Return a cell for people: large whole numbers in groups of three, small ones by powers of ten."""
    if isinstance(cell, str):
        return html.escape(cell)
    if isinstance(cell, int) or (float(cell).is_integer() and abs(cell) >= 1e4):
        return f"{cell:,.0f}".replace(",", "\u202f")
    if cell != 0.0 and abs(cell) < 1e-4:
        return f"{cell:.3e}"
    return f"{cell:g}" if abs(cell) < 1e3 else f"{cell:.1f}"


def _picture(picture: Picture, folder: Path) -> str:
    encoded = base64.b64encode((folder / picture.file).read_bytes()).decode("ascii")
    caption = html.escape(picture.caption)
    return (
        f'<figure><img alt="{caption}" src="data:image/png;base64,{encoded}">'
        f"<figcaption>{caption}</figcaption></figure>\n"
    )


def _plain(value: Any) -> Any:
    """Return numpy's numbers as Python's; JSON knows no others."""
    if isinstance(value, np.generic):
        return value.item()
    msg = f"{type(value)} is not for JSON"
    raise TypeError(msg)

