#!/usr/bin/env python3
"""Checks the documents: every relative link and anchor resolves, every file path in backticks and every page that
a source file names exists, every page is in docs/SUMMARY.md.

    .ci/links.py        exit code 1 and one line per fault
"""

import re
import subprocess
import sys
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PAGES = ["README.md", "CONTRIBUTING.md", "CHANGELOG.md", "docs/**/*.md", "hil/**/*.md", "examples/**/*.md"]
# What a path in backticks begins with when it is one of this repository.
FOLDERS = ("benches", "config", "crates", "docs", "examples", "hil", "src", "systemd", "tests", ".ci", ".cargo")

FENCE = re.compile(r"^ *(```|~~~)")
LINK = re.compile(r"!?\[(?:[^\]\\]|\\.)*\]\(([^)\s]+)(?:\s+\"[^\"]*\")?\)")
HEADING = re.compile(r"^#{1,6}\s+(.*?)\s*#*$")
CODE = re.compile(r"`([^`\n]+)`")
PATH = re.compile(r"^(?:%s)(?:/[\w.@<>*-]+)+/?$" % "|".join(re.escape(folder) for folder in FOLDERS))


def lines_of_text(page):
    """Number and text of every line outside fenced blocks."""
    fenced = False
    for number, line in enumerate(page.read_text().splitlines(), 1):
        if FENCE.match(line):
            fenced = not fenced
        elif not fenced:
            yield number, line


@cache
def anchors(page):
    """The anchors of a page's headings, as GitHub and mdBook make them."""
    found = set()
    for _, line in lines_of_text(page):
        if match := HEADING.match(line):
            text = LINK.sub(lambda link: link.group(0).split("](")[0].lstrip("!["), match.group(1))
            name = re.sub(r"[^\w\- ]", "", text.lower()).replace(" ", "-")
            count = sum(other == name or re.fullmatch(re.escape(name) + r"-\d+", other) is not None for other in found)
            found.add(f"{name}-{count}" if count else name)
    return frozenset(found)


@cache
def tracked():
    """Files of the repository; generated ones that lie in a working copy do not count."""
    listed = subprocess.run(["git", "ls-files", "-co", "--exclude-standard"], cwd=ROOT, capture_output=True, text=True)
    return frozenset(listed.stdout.splitlines())


def exists(path):
    if any(c in path for c in "*<>"):
        return True
    path = path.rstrip("/")
    return path in tracked() or any(file.startswith(path + "/") for file in tracked())


def faults_of(page):
    name = page.relative_to(ROOT).as_posix()
    for number, line in lines_of_text(page):
        plain = CODE.sub("", line)
        for target in LINK.findall(plain):
            if re.match(r"[a-z]+:", target):
                continue
            file, _, anchor = target.partition("#")
            goal = (page.parent / file).resolve() if file else page
            if not goal.exists():
                yield f"{name}:{number}: no file {target}"
            elif ROOT / "docs" in page.parents and ROOT / "docs" not in goal.parents:
                yield f"{name}:{number}: {target} is outside the book (name it in backticks)"
            elif anchor and goal.suffix == ".md" and anchor not in anchors(goal):
                yield f"{name}:{number}: no heading {target}"
        for code in CODE.findall(line):
            if PATH.match(code) and not exists(code):
                yield f"{name}:{number}: no file `{code}`"


def pages_named_in_code():
    """Pages of docs/ that a source file names and that do not exist."""
    for file in sorted(tracked()):
        if file.endswith((".rs", ".py", ".sh", ".toml", ".service")) and (ROOT / file).is_file():
            for number, line in enumerate((ROOT / file).read_text().splitlines(), 1):
                for page in re.findall(r"(?<![\w/])(?:docs|hil)/[\w/-]+\.md", line):
                    if not exists(page):
                        yield f"{file}:{number}: no page {page}"


def main():
    pages = sorted({page for pattern in PAGES for page in ROOT.glob(pattern)})
    faults = [fault for page in pages for fault in faults_of(page)] + list(pages_named_in_code())
    summary = (ROOT / "docs/SUMMARY.md").read_text()
    for page in (ROOT / "docs").glob("*/**/*.md"):
        if f"({page.relative_to(ROOT / 'docs').as_posix()})" not in summary:
            faults.append(f"docs/SUMMARY.md: lacks {page.relative_to(ROOT).as_posix()}")
    print("\n".join(faults) or f"{len(pages)} pages: every link, anchor and path resolves")
    sys.exit(bool(faults))


main()
