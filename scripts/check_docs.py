"""Checks the Markdown pages without a network: relative links, anchors, and the table of contents of the book.

Usage: python3 scripts/check_docs.py

- Every relative link points to a file or folder that git tracks (or that is new and not ignored), and every `#anchor` to a heading.
- Every page below docs/ is listed in docs/SUMMARY.md, and SUMMARY.md names pages that exist.

Exit code 1 if there are problems; each problem is one line `FILE:LINE: PROBLEM`.
"""

import re
import subprocess
import sys
import unicodedata
from pathlib import Path
from urllib.parse import unquote

ROOT = Path(__file__).resolve().parent.parent
LINK = re.compile(r"!?\[(?:[^\[\]]|\[[^\[\]]*\])*\]\(\s*<?([^()\s<>]+(?:\([^()\s]*\)[^()\s<>]*)?)>?(?:\s+\"[^\"]*\")?\s*\)")
REFERENCE = re.compile(r"^ {0,3}\[[^\]]+\]:\s*<?(\S+?)>?\s*$")
FENCE = re.compile(r"^ {0,3}(```+|~~~+)")
HEADING = re.compile(r"^ {0,3}(#{1,6})\s+(.*?)\s*#*\s*$")


def tracked():
    """Tracked files, and new ones that git does not ignore."""
    names = subprocess.run(
        ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"], cwd=ROOT, check=True, capture_output=True
    ).stdout.decode()
    return {ROOT / name for name in names.split("\0") if name and (ROOT / name).exists()}


def lines(text):
    """Numbered lines outside code blocks, without inline code."""
    fence = None
    for number, line in enumerate(text.splitlines(), 1):
        mark = FENCE.match(line)
        if fence:
            if mark and mark[1].startswith(fence) and line.strip() == mark[1]:
                fence = None
            continue
        if mark:
            fence = mark[1]
            continue
        yield number, line


def slug(heading):
    """The anchors that GitHub and mdBook generate for headings."""
    text = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", heading).replace("`", "").replace("*", "")
    text = unicodedata.normalize("NFC", text.strip().lower())
    kept = "".join(c for c in text if c.isalnum() or c in " -_")
    return kept.replace(" ", "-")


def anchors(page):
    found, seen = set(), {}
    text = page.read_text(encoding="utf-8")
    for _, line in lines(text):
        if heading := HEADING.match(line):
            name = slug(heading[2])
            seen[name] = seen.get(name, -1) + 1
            found.add(f"{name}-{seen[name]}" if seen[name] else name)
        found.update(re.findall(r"<a (?:id|name)=\"([^\"]+)\"", line))
    return found


def targets(page):
    for number, line in lines(page.read_text(encoding="utf-8")):
        plain = re.sub(r"`[^`]*`", lambda code: "`" * len(code[0]), line)
        for link in LINK.finditer(plain):
            # The text of a link may be code; its target never is, so positions in both lines agree.
            yield number, line[link.start(1) : link.end(1)]
        if reference := REFERENCE.match(plain):
            yield number, reference[1]


def main():
    files = tracked()
    folders = {parent for file in files for parent in file.parents}
    pages = sorted(file for file in files if file.suffix == ".md")
    known = {page: anchors(page) for page in pages}
    problems, links = [], 0
    for page in pages:
        for number, target in targets(page):
            if re.match(r"^[a-z][a-z0-9+.-]*:", target):
                continue
            links += 1
            where = f"{page.relative_to(ROOT)}:{number}"
            path, _, anchor = target.partition("#")
            file = (page.parent / unquote(path)).resolve() if path else page
            if file not in files and file not in folders:
                problems.append(f"{where}: the link `{target}` points to no file of the repository")
            elif anchor and file in known and anchor not in known[file]:
                problems.append(f"{where}: `{file.relative_to(ROOT)}` has no heading `#{anchor}`")
    summary = ROOT / "docs/SUMMARY.md"
    listed = {(summary.parent / unquote(target.partition("#")[0])).resolve() for _, target in targets(summary)}
    for page in pages:
        if summary.parent in page.parents and page != summary and page not in listed:
            problems.append(f"docs/SUMMARY.md: `{page.relative_to(ROOT / 'docs')}` is missing")
    print("\n".join(problems) if problems else f"{len(pages)} pages, {links} relative links: all found")
    return 1 if problems else 0


if __name__ == "__main__":
    sys.exit(main())
