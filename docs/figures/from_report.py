#!/usr/bin/env python3
"""Takes one plot out of a report as an SVG file.

    docs/figures/from_report.py REPORT.html CAPTION OUT.svg

CAPTION is the beginning of the text above the plot; a plot without one is found by the heading above it.
"""

import html
import re
import sys
from pathlib import Path


def main():
    report, caption, out = sys.argv[1:]
    page = Path(report).read_text()
    heads = re.compile(r"<(h[1-4]|figcaption|p)\b[^>]*>(.*?)</\1>", re.S)
    for head in heads.finditer(page):
        text = html.unescape(re.sub(r"<[^>]*>", "", head.group(2))).strip()
        svg = re.search(r"<svg\b.*?</svg>", page[head.end() :], re.S)
        if text.startswith(caption) and svg:
            background = r'\1<rect width="100%" height="100%" fill="white"/>'
            Path(out).write_text(re.sub(r"(<svg[^>]*>)", background, svg.group(0), count=1) + "\n")
            return
    sys.exit(f"{report}: no plot under a caption that begins with `{caption}`")


main()
