"""The project's pages: every link between them leads somewhere, and code cites no page that a user lacks."""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PAGES = sorted(
    [
        *ROOT.glob("*.md"),
        *(ROOT / "docs").glob("*.md"),
        *(ROOT / "results" / "measured").rglob("*.md"),
        *(ROOT / "pipeline").rglob("*.md"),
    ]
)
CODE = sorted(
    path
    for folder in ("conf", "datasets", "pipeline", "rasterizer", "tests", "tools")
    for pattern in ("*.py", "*.hpp", "*.cpp", "*.yaml")
    for path in (ROOT / folder).rglob(pattern)
)


def anchors(page: Path) -> set[str]:
    """What a heading is linked by: lower case, punctuation dropped, spaces as dashes."""
    headings = re.findall(r"^#+ (.+)$", page.read_text(encoding="utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def leads_somewhere(page: Path, target: str) -> bool:
    if target.startswith(("http:", "https:", "data:")):
        return True
    path, _, anchor = target.partition("#")
    found = (page.parent / path).resolve() if path else page
    return found.exists() and (not anchor or anchor in anchors(found))


def test_every_link_leads_somewhere() -> None:
    for page in PAGES:
        links = re.findall(r"\]\(([^)\s]+)\)", page.read_text(encoding="utf-8"))
        assert [link for link in links if not leads_somewhere(page, link)] == [], page.name


def test_code_cites_pages_that_are_here() -> None:
    cited = {
        (path.relative_to(ROOT).as_posix(), name)
        for path in CODE
        if path != Path(__file__).resolve()
        for name in re.findall(r"\b(docs/\w+\.md|[A-Z]+\.md|SPEC \d)", path.read_text(encoding="utf-8"))
    }
    assert ("pipeline/training/loop.py", "docs/method.md") in cited
    assert [where for where in sorted(cited) if not (ROOT / where[1]).exists()] == []


def test_sections_that_code_cites_exist() -> None:
    headings = set(re.findall(r"^#+ ([\d.]+) ", (ROOT / "docs/method.md").read_text(encoding="utf-8"), re.MULTILINE))
    headings = {heading.rstrip(".") for heading in headings}
    for path in CODE:
        for section in re.findall(r"docs/method\.md\s+(?:#\s*)?(\d(?:\.\d)?)", path.read_text(encoding="utf-8")):
            assert section in headings, f"{path}: docs/method.md {section}"
